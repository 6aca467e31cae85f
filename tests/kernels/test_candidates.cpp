#include "../../csrc/kernels/candidates/candidates.h"
#include "check.h"

using namespace anynet;

void test_costs(Isa isa, int threads, int64_t G, int64_t H, int64_t W, int64_t radius) {
  check::Random random;
  const int64_t C = 4, first = -2, count = 4, pixels = H * W;
  const check::Array<float> features({2, C, H, W}, [&] { return random(); });
  const check::Array<float, 2> disparity({H, W}, [&] { return 6 * random(); });
  std::vector<double> expected((G * (count + 2) + C + 2) * pixels);
  double* const max_costs = expected.data() + G * count * pixels;
  double* const min_costs = max_costs + G * pixels;
  double* const left = min_costs + G * pixels;
  double* const offsets = left + C * pixels;
  for (int64_t y = 0; y < H; ++y) {
    for (int64_t x = 0; x < W; ++x) {
      const int64_t at = y * W + x;
      double most = -1e9, least = 1e9;
      for (int64_t i = y - radius; i <= y + radius; ++i) {
        for (int64_t j = x - radius; j <= x + radius; ++j) {
          if (i < 0 || j < 0 || i >= H || j >= W) continue;
          most = std::fmax(most, disparity.at(i, j));
          least = std::fmin(least, disparity.at(i, j));
        }
      }
      const auto cost = [&](int64_t g, double d) {
        double sum = 0;
        for (int64_t c = g * C / G; c < (g + 1) * C / G; ++c) {
          const auto row = [&](int64_t column) { return features.at(int64_t{1}, c, y, column); };
          sum += std::fabs(features.at(int64_t{0}, c, y, x) - check::sample(row, W, static_cast<double>(x) - d));
        }
        return sum;
      };
      for (int64_t g = 0; g < G; ++g) {
        for (int64_t k = 0; k < count; ++k) {
          expected[(g * count + k) * pixels + at] = cost(g, disparity.at(y, x) + static_cast<double>(first + k));
        }
        max_costs[g * pixels + at] = cost(g, most);
        min_costs[g * pixels + at] = cost(g, least);
      }
      for (int64_t c = 0; c < C; ++c) left[c * pixels + at] = features.at(int64_t{0}, c, y, x);
      offsets[at] = most - disparity.at(y, x);
      offsets[pixels + at] = least - disparity.at(y, x);
    }
  }
  std::vector<float> out(expected.size());
  const CandidateCosts<float> args{C,     G,     H,      W,         features.view.data, disparity.view.data,
                                   first, count, radius, out.data()};
  candidate_costs(isa, args, threads);
  check::near("candidate_costs", out, expected);
}

void test_expected(Isa isa, int threads, int64_t count, int64_t pixels, double spread) {
  check::Random random;
  const check::Array<float, 2> cost({count, pixels}, [&] { return spread * random(); });
  const check::Array<float, 2> offsets({2, pixels}, [&] { return 10 * random(); });
  const check::Array<float, 1> disparity({pixels}, [&] { return random(); });
  std::vector<double> expected;
  for (int64_t i = 0; i < pixels; ++i) {
    double sum = 0, mean = 0;
    for (int64_t k = 0; k < count; ++k) {
      const double weight = std::exp(-cost.at(k, i));
      sum += weight;
      mean += weight * (k < count - 2 ? static_cast<double>(k - 1) : offsets.at(k - (count - 2), i));
    }
    expected.push_back(disparity.at(i) + mean / sum);
  }
  std::vector<float> out(expected.size());
  const ExpectedDisparity<float> args{count, pixels,    cost.view.data, disparity.view.data, offsets.view.data,
                                      -1,    out.data()};
  expected_disparity(isa, args, threads);
  check::near("expected_disparity", out, expected);

  // NaN and infinite costs: any result, but within bounds and defined (UBSan).
  std::vector<float> special(count * pixels, NAN);
  for (size_t i = 0; i < special.size(); i += 3) special[i] = i % 2 ? INFINITY : -INFINITY;
  ExpectedDisparity<float> undefined = args;
  undefined.cost = special.data();
  expected_disparity(isa, undefined, threads);
}

int main() {
  check::for_each_isa([](Isa isa, int threads) {
    for (int64_t groups : {1, 2}) {
      for (int64_t radius : {0, 1, 5}) {
        test_costs(isa, threads, groups, 1, 1, radius);
        test_costs(isa, threads, groups, 3, 7, radius);
        test_costs(isa, threads, groups, 20, 67, radius);
      }
    }
    for (double spread : {3.0, 300.0}) {
      test_expected(isa, threads, 2, 1, spread);
      test_expected(isa, threads, 7, 37, spread);
      test_expected(isa, threads, 9, 20000, spread);
    }
  });
}
