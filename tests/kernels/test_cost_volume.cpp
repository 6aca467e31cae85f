#include "../../csrc/kernels/cost_volume/cost_volume.h"
#include "check.h"

using namespace anynet;

template <class T>
void test(Isa isa, int threads, int64_t N, int64_t C, int64_t H, int64_t W, int64_t first, int64_t K, double reach,
          int64_t spread) {
  check::Random random;
  // Left and right lie on different grids of numbers that every type holds, so that no difference is near 0.
  const check::Array<T> left({N, C, H, W}, [&] { return std::floor(8 * random()) / 4 + 1.0 / 32; }, spread);
  const check::Array<T> right({N, C, H, W}, [&] { return std::floor(8 * random()) / 4; }, spread);
  const check::Array<T> grad({N, K, H, W}, random, spread);
  const bool around = reach > 0;
  const auto quarters = [&] { return std::floor(2 * reach * random()) / 2 + 0.25; };
  const check::Array<T> disparity({N, 1, H, W}, quarters, spread);
  std::vector<double> expected(N * K * H * W), grad_left(N * C * H * W), grad_right(N * C * H * W);
  std::vector<double> grad_disparity(N * H * W);
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t c = 0; c < C; ++c) {
      for (int64_t y = 0; y < H; ++y) {
        const auto row = [&](int64_t x) { return right.at(n, c, y, x); };
        for (int64_t x = 0; x < W; ++x) {
          for (int64_t k = 0; k < K; ++k) {
            const double d = around ? disparity.at(n, int64_t{0}, y, x) : 0;
            const double p = static_cast<double>(x) - d - static_cast<double>(first + k), i = std::floor(p);
            const double difference = left.at(n, c, y, x) - check::sample(row, W, p), g = grad.at(n, k, y, x);
            const double gs = difference > 0 ? g : difference < 0 ? -g : 0;
            expected[((n * K + k) * H + y) * W + x] += std::fabs(difference);
            grad_left[((n * C + c) * H + y) * W + x] += gs;
            grad_disparity[(n * H + y) * W + x] += gs * (check::sample(row, W, i + 1) - check::sample(row, W, i));
            for (int64_t j = 0; j < W; ++j) {
              const double weight = 1 - std::fabs(p - static_cast<double>(j));
              if (weight > 0) grad_right[((n * C + c) * H + y) * W + j] -= gs * weight;
            }
          }
        }
      }
    }
  }
  const View4<const T> map = around ? disparity.view : View4<const T>{};
  std::vector<T> out(expected.size()), got_left(grad_left.size()), got_right(grad_right.size());
  std::vector<T> got_disparity(grad_disparity.size());
  cost_volume(isa, CostVolume<T>{left.view, right.view, map, first, K, out.data()}, threads);
  check::near("cost_volume", out, expected);
  if constexpr (std::is_same_v<T, float>) {  // the deployed network's: through an affine and ReLU, by sample
    const check::Affine affine(N > 0 ? N : 1, random);
    std::vector<double> activated(expected.size());
    for (size_t i = 0; i < expected.size(); ++i) {
      activated[i] = affine(static_cast<int64_t>(i) / (K * H * W), expected[i]);
    }
    std::vector<T> fused(expected.size());
    cost_volume(isa, CostVolume<T>{left.view, right.view, map, first, K, fused.data(), affine.epilogue()}, threads);
    check::near("cost_volume, affine, ReLU", fused, activated);
  }
  cost_volume_backward(isa,
                       CostVolumeBackward<T>{grad.view, left.view, right.view, map, first, K, got_left.data(),
                                             got_right.data(), around ? got_disparity.data() : nullptr},
                       threads);
  check::near("cost_volume_backward left", got_left, grad_left);
  check::near("cost_volume_backward right", got_right, grad_right);
  if (around) check::near("cost_volume_backward disparity", got_disparity, grad_disparity);
}

int main() {
  check::for_each_variant([](Isa isa, auto type, int threads) {
    using T = decltype(type);
    for (double reach : {0.0, 3.0, 500.0}) {
      test<T>(isa, threads, 1, 1, 1, 1, 0, 1, reach, 1);
      test<T>(isa, threads, 2, 3, 3, 7, -2, 5, reach, 1);
      test<T>(isa, threads, 1, 2, 2, 5, 0, 12, reach, 1);
      test<T>(isa, threads, 1, 5, 20, 67, 0, 12, reach, 2);
      test<T>(isa, threads, 1, 18, 4, 37, -2, 5, reach, 1);
      test<T>(isa, threads, 1, 1, 1, 33, -40, 30, reach, 1);
      test<T>(isa, threads, 1, 1, 2, 9, 100, 3, reach, 1);
      test<T>(isa, threads, 0, 2, 2, 5, 0, 2, reach, 1);
      test<T>(isa, threads, 1, 0, 2, 5, 0, 2, reach, 1);
      test<T>(isa, threads, 1, 2, 2, 0, 0, 2, reach, 1);
    }
  });
}
