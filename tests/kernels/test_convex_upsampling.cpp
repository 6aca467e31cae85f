#include "../../csrc/kernels/convex_upsampling/convex_upsampling.h"
#include "check.h"

using namespace anynet;

void test(Isa isa, int threads, int64_t N, int64_t H, int64_t W, double spread) {
  check::Random random;
  const check::Array<float> in({N, 1, H, W}, [&] { return random(); });
  const check::Array<float> logits({N, 32, H, W}, [&] { return spread * random(); });
  const auto clamp = [](int64_t i, int64_t size) { return i < 0 ? 0 : i < size ? i : size - 1; };
  std::vector<double> expected(N * 4 * H * W);
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t y = 0; y < H; ++y) {
      for (int64_t x = 0; x < W; ++x) {
        for (int64_t k = 0; k < 4; ++k) {
          double sum = 0, value = 0;
          for (int64_t i = 0; i < 9; ++i) {
            const double logit = i == 4 ? 0 : logits.at(n, 8 * k + (i < 4 ? i : i - 1), y, x);
            const double weight = std::exp(logit);
            sum += weight;
            value += weight * in.at(n, int64_t{0}, clamp(y + i / 3 - 1, H), clamp(x + i % 3 - 1, W));
          }
          expected[(n * 2 * H + 2 * y + k / 2) * 2 * W + 2 * x + k % 2] = value / sum;
        }
      }
    }
  }
  std::vector<float> out(expected.size());
  const ConvexUpsampling<float> args{N, H, W, in.view.data, logits.view.data, out.data()};
  convex_upsampling(isa, args, threads);
  check::near("convex_upsampling", out, expected);
}

int main() {
  check::for_each_isa([](Isa isa, int threads) {
    for (double spread : {2.0, 200.0}) {
      test(isa, threads, 1, 1, 1, spread);
      test(isa, threads, 2, 3, 7, spread);
      test(isa, threads, 1, 4, 16, spread);
      test(isa, threads, 2, 20, 67, spread);
      test(isa, threads, 0, 3, 4, spread);
    }
  });
}
