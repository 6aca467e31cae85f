#include "../../csrc/kernels/resize/resize.h"
#include "check.h"

using namespace anynet;

template <class T>
void test(Isa isa, int threads, int64_t h, int64_t w, int64_t H, int64_t W, bool align_corners, int64_t spread) {
  check::Random random;
  const int64_t N = 2, C = 3;
  const double scale = -1.5;
  const check::Array<T> input({N, C, h, w}, random, spread), add({N, C, H, W}, random, spread);
  const check::Array<T> grad({N, C, H, W}, random, spread);
  const auto position = [&](int64_t i, int64_t out, int64_t in) {
    return align_corners ? check::corner(i, out, in)
                         : check::half_pixel(i, static_cast<double>(out) / static_cast<double>(in), in);
  };
  std::vector<double> expected, expected_grad(N * C * h * w);
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t c = 0; c < C; ++c) {
      const auto read = [&](int64_t y, int64_t x) { return input.at(n, c, y, x); };
      double* const plane = expected_grad.data() + (n * C + c) * h * w;
      for (int64_t y = 0; y < H; ++y) {
        for (int64_t x = 0; x < W; ++x) {
          const check::Linear row = position(y, H, h), column = position(x, W, w);
          expected.push_back(add.at(n, c, y, x) + scale * check::bilinear(read, row, column));
          const double g = scale * grad.at(n, c, y, x);
          plane[row.low * w + column.low] += (1 - row.fraction) * (1 - column.fraction) * g;
          plane[row.low * w + column.high] += (1 - row.fraction) * column.fraction * g;
          plane[row.high * w + column.low] += row.fraction * (1 - column.fraction) * g;
          plane[row.high * w + column.high] += row.fraction * column.fraction * g;
        }
      }
    }
  }
  std::vector<T> out(expected.size()), grad_input(expected_grad.size());
  resize(isa, Resize<T>{input.view, add.view, H, W, scale, align_corners, out.data()}, threads);
  check::near("resize", out, expected);
  resize_backward(isa, ResizeBackward<T>{grad.view, h, w, scale, align_corners, grad_input.data()}, threads);
  check::near("resize_backward", grad_input, expected_grad);
}

int main() {
  check::for_each_variant([](Isa isa, auto type, int threads) {
    using T = decltype(type);
    for (bool align_corners : {false, true}) {
      test<T>(isa, threads, 1, 1, 1, 1, align_corners, 1);
      test<T>(isa, threads, 5, 7, 20, 28, align_corners, 1);
      test<T>(isa, threads, 9, 40, 4, 10, align_corners, 2);
      test<T>(isa, threads, 6, 1, 1, 5, align_corners, 1);
      test<T>(isa, threads, 23, 77, 46, 154, align_corners, 1);
    }
  });
}
