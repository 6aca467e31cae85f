#include "../../csrc/kernels/warp/warp.h"
#include "check.h"

using namespace anynet;

template <class T>
void test(Isa isa, int threads, int64_t N, int64_t C, int64_t H, int64_t W, double reach, int64_t spread) {
  check::Random random;
  const check::Array<T> image({N, C, H, W}, random, spread), grad({N, C, H, W}, random, spread);
  // An odd number of quarters is exact in every type, and never a whole pixel.
  const auto quarters = [&] { return std::floor(2 * reach * random()) / 2 + 0.25; };
  const check::Array<T> disparity({N, 1, H, W}, quarters, spread);
  std::vector<double> expected(N * C * H * W), grad_image(expected.size()), grad_disparity(N * H * W);
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t c = 0; c < C; ++c) {
      for (int64_t y = 0; y < H; ++y) {
        const auto row = [&](int64_t x) { return image.at(n, c, y, x); };
        for (int64_t x = 0; x < W; ++x) {
          const double p = static_cast<double>(x) - disparity.at(n, int64_t{0}, y, x), g = grad.at(n, c, y, x);
          const double i = std::floor(p);
          expected[((n * C + c) * H + y) * W + x] = check::sample(row, W, p);
          grad_disparity[(n * H + y) * W + x] -= g * (check::sample(row, W, i + 1) - check::sample(row, W, i));
          for (int64_t j = 0; j < W; ++j) {
            const double weight = 1 - std::fabs(p - static_cast<double>(j));
            if (weight > 0) grad_image[((n * C + c) * H + y) * W + j] += g * weight;
          }
        }
      }
    }
  }
  std::vector<T> out(expected.size()), got_image(expected.size()), got_disparity(grad_disparity.size());
  warp(isa, Warp<T>{image.view, disparity.view, out.data()}, threads);
  check::near("warp", out, expected);
  warp_backward(isa, WarpBackward<T>{grad.view, image.view, disparity.view, got_image.data(), got_disparity.data()},
                threads);
  check::near("warp_backward image", got_image, grad_image);
  check::near("warp_backward disparity", got_disparity, grad_disparity);
}

int main() {
  check::for_each_variant([](Isa isa, auto type, int threads) {
    using T = decltype(type);
    test<T>(isa, threads, 1, 1, 1, 1, 1, 1);
    test<T>(isa, threads, 2, 3, 3, 7, 4, 1);
    test<T>(isa, threads, 1, 2, 5, 67, 3, 2);
    test<T>(isa, threads, 1, 8, 60, 130, 40, 1);  // far apart
    test<T>(isa, threads, 1, 2, 2, 19, 1000, 1);  // mostly outside
    test<T>(isa, threads, 0, 2, 2, 5, 1, 1);
    test<T>(isa, threads, 1, 2, 2, 0, 1, 1);
  });
}
