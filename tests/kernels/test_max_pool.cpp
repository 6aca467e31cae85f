#include "../../csrc/kernels/max_pool/max_pool.h"
#include "check.h"

using namespace anynet;

void test(Isa isa, int threads, int64_t N, int64_t C, int64_t H, int64_t W) {
  check::Random random;
  const check::Array<float> in({N, C, H, W}, [&] { return random(); });
  const check::Affine affine(C, random);
  std::vector<double> expected;
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t c = 0; c < C; ++c) {
      for (int64_t y = 0; y < H / 2; ++y) {
        for (int64_t x = 0; x < W / 2; ++x) {
          const double upper = std::fmax(in.at(n, c, 2 * y, 2 * x), in.at(n, c, 2 * y, 2 * x + 1));
          const double lower = std::fmax(in.at(n, c, 2 * y + 1, 2 * x), in.at(n, c, 2 * y + 1, 2 * x + 1));
          expected.push_back(affine(c, std::fmax(upper, lower)));
        }
      }
    }
  }
  std::vector<float> out(expected.size());
  max_pool(isa, MaxPool<float>{N, C, H, W, in.view.data, affine.epilogue(), out.data()}, threads);
  check::near("max_pool", out, expected);
}

int main() {
  check::for_each_isa([](Isa isa, int threads) {
    test(isa, threads, 1, 1, 2, 2);
    test(isa, threads, 2, 3, 5, 37);
    test(isa, threads, 1, 2, 1, 9);
    test(isa, threads, 2, 4, 60, 101);
    test(isa, threads, 0, 2, 4, 4);
  });
}
