#include "../../csrc/kernels/upsample/upsample.h"
#include "check.h"

using namespace anynet;

void test_sum(Isa isa, int threads, int64_t H, int64_t W, int64_t crop) {
  check::Random random;
  std::vector<check::Array<float, 2>> maps;
  UpsampleSum<float> args{};
  args.count = 5;
  args.side = crop == 0 ? 0.125f : 0;
  args.out_height = 16 * H - crop;
  args.out_width = 16 * W - crop;
  for (int i = 0; i < args.count; ++i) {
    args.ratio[i] = 16 >> i;
    args.height[i] = H << i;
    args.width[i] = W << i;
    args.gain[i] = static_cast<float>(i - 1) / 4;
    maps.emplace_back(std::vector<int64_t>{args.height[i], args.width[i]}, [&] { return random(); });
  }
  for (int i = 0; i < args.count; ++i) args.map[i] = maps[i].values.data();
  std::vector<double> expected;
  for (int64_t y = 0; y < args.out_height; ++y) {
    for (int64_t x = 0; x < args.out_width; ++x) {
      double sum = 0;
      for (int i = 0; i < args.count; ++i) {
        const auto stored = [&](int64_t row, int64_t column) {
          row = std::min(std::max<int64_t>(row, 0), args.height[i] - 1);
          column = std::min(std::max<int64_t>(column, 0), args.width[i] - 1);
          return static_cast<double>(maps[i].values[row * args.width[i] + column]);
        };
        const auto read = [&](int64_t row, int64_t column) {
          if (i + 1 < args.count) return stored(row, column);
          const double weights[] = {args.side, 1 - 2 * args.side, args.side};
          double smoothed = 0;
          for (int j = 0; j < 9; ++j) {
            smoothed += weights[j / 3] * weights[j % 3] * stored(row + j / 3 - 1, column + j % 3 - 1);
          }
          return smoothed;
        };
        const double ratio = static_cast<double>(args.ratio[i]);
        sum += args.gain[i] * check::bilinear(read, check::half_pixel(y, ratio, args.height[i]),
                                              check::half_pixel(x, ratio, args.width[i]));
      }
      expected.push_back(sum);
    }
  }
  std::vector<float> out(expected.size());
  args.out = out.data();
  upsample_sum(isa, args, threads);
  check::near("upsample_sum", out, expected);
}

void test_concat(Isa isa, int threads, int64_t H, int64_t W, int64_t h, int64_t w) {
  check::Random random;
  const int64_t N = 2, S = 3, C = 2;
  const check::Array<float> skip({N, S, H, W}, [&] { return random(); });
  const check::Array<float> coarse({N, C, h, w}, [&] { return random(); });
  const check::Affine affine(S + C, random);
  std::vector<double> expected;
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t c = 0; c < S + C; ++c) {
      const auto read = [&](int64_t y, int64_t x) { return coarse.at(n, c - S, y, x); };
      for (int64_t y = 0; y < H; ++y) {
        for (int64_t x = 0; x < W; ++x) {
          expected.push_back(affine(
              c, c < S ? skip.at(n, c, y, x) : check::bilinear(read, check::corner(y, H, h), check::corner(x, W, w))));
        }
      }
    }
  }
  std::vector<float> out(expected.size());
  const UpsampleConcat<float> args{N,         S, C, H, W, h, w, skip.view.data, coarse.view.data, affine.epilogue(),
                                   out.data()};
  upsample_concat(isa, args, threads);
  check::near("upsample_concat", out, expected);
}

void test_add(Isa isa, int threads, int64_t D, int64_t H, int64_t W, int64_t d, int64_t h, int64_t w) {
  check::Random random;
  const int64_t N = 2, C = 2;
  const check::Array<float, 5> input({N, C, D, H, W}, [&] { return random(); });
  const check::Array<float, 5> coarse({N, C, d, h, w}, [&] { return random(); });
  const check::Affine affine(C, random);
  const auto position = [](int64_t i, int64_t size, int64_t small) {
    return check::half_pixel(i, static_cast<double>(size) / static_cast<double>(small), small);
  };
  std::vector<double> expected;
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t c = 0; c < C; ++c) {
      for (int64_t z = 0; z < D; ++z) {
        for (int64_t y = 0; y < H; ++y) {
          for (int64_t x = 0; x < W; ++x) {
            const check::Linear depth = position(z, D, d);
            const auto plane = [&](int64_t i) {
              const auto read = [&](int64_t row, int64_t column) { return coarse.at(n, c, i, row, column); };
              return check::bilinear(read, position(y, H, h), position(x, W, w));
            };
            const double value = (1 - depth.fraction) * plane(depth.low) + depth.fraction * plane(depth.high);
            expected.push_back(affine(c, input.at(n, c, z, y, x) + value));
          }
        }
      }
    }
  }
  std::vector<float> out(expected.size());
  const UpsampleAdd<float> args{N,         C, D, H, W, d, h, w, input.view.data, coarse.view.data, affine.epilogue(),
                                out.data()};
  upsample_add(isa, args, threads);
  check::near("upsample_add", out, expected);
}

int main() {
  check::for_each_isa([](Isa isa, int threads) {
    for (int64_t crop : {0, 3}) {
      test_sum(isa, threads, 1, 1, crop);
      test_sum(isa, threads, 2, 5, crop);
      test_sum(isa, threads, 5, 37, crop);
    }
    test_concat(isa, threads, 1, 1, 1, 1);
    test_concat(isa, threads, 7, 19, 4, 10);
    test_concat(isa, threads, 60, 101, 30, 51);
    test_concat(isa, threads, 2, 3, 5, 1);
    test_add(isa, threads, 1, 1, 1, 1, 1, 1);
    test_add(isa, threads, 5, 7, 19, 3, 4, 10);
    test_add(isa, threads, 6, 30, 64, 3, 15, 32);
    test_add(isa, threads, 2, 3, 5, 1, 1, 1);
  });
}
