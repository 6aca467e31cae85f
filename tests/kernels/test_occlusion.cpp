#include <algorithm>

#include "../../csrc/kernels/occlusion/occlusion.h"
#include "check.h"

using namespace anynet;

void test(Isa isa, int threads, int64_t rows, int64_t width, double pixel) {
  check::Random random;
  const check::Array<float, 2> disparity({rows, width},
                                         [&] { return pixel * ((random() > 0.6 ? 25 : 8) + 4 * random()); });
  std::vector<double> expected(rows * width);
  const auto clamp = [](double v) { return std::fmin(std::fmax(v, 0), 1); };
  for (int64_t y = 0; y < rows; ++y) {
    const auto position = [&](int64_t x) { return static_cast<double>(x) - disparity.at(y, x) / pixel; };
    double* out = expected.data() + y * width;
    for (int64_t x = width - 1; x >= 0; --x) {
      const double gate = clamp(-position(x) / 2), right = x + 1 < width ? out[x + 1] : disparity.at(y, x);
      out[x] = (1 - gate) * disparity.at(y, x) + gate * right;
    }
    for (int64_t x = 1; x < width; ++x) {
      double leftmost = position(x);
      for (int64_t i = x; i < width; ++i) leftmost = std::min(leftmost, position(i));
      const double gate = clamp((position(x) - leftmost - 0.5) / 2) * (1 - clamp(-position(x) / 2));
      out[x] = (1 - gate) * out[x] + gate * out[x - 1];
    }
  }
  std::vector<float> out(expected.size());
  const FillOcclusions<float> args{rows, width, disparity.view.data, static_cast<float>(pixel), out.data()};
  fill_occlusions(isa, args, threads);
  check::near("fill_occlusions", out, expected);
}

int main() {
  check::for_each_isa([](Isa isa, int threads) {
    test(isa, threads, 1, 1, 1);
    test(isa, threads, 3, 2, 1);
    test(isa, threads, 5, 70, 4);
    test(isa, threads, 90, 300, 2);
    test(isa, threads, 0, 7, 1);
  });
}
