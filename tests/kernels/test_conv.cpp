// The convolutions against plain loops, on buffers without a spare element: under AddressSanitizer a read or write one
// element before or behind a tensor fails, under ThreadSanitizer a race does.
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "../../csrc/kernels/conv/conv.h"

namespace {

using anynet::ConvShape;
using anynet::Isa;

int failures = 0;

template <class T>
std::vector<T> random_values(int64_t count, int seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<T> uniform(-1, 1);
  std::vector<T> values(count);
  for (T& v : values) v = uniform(engine);
  values.shrink_to_fit();
  return values;
}

template <class T>
void expect_near(const char* what, Isa isa, const ConvShape& s, const std::vector<T>& got, const std::vector<T>& want) {
  T largest = 1;
  for (T v : want) largest = std::max(largest, std::abs(v));
  const T tolerance = (sizeof(T) == 4 ? T(1e-5) : T(1e-12)) * largest;
  for (size_t i = 0; i < want.size(); ++i) {
    if (std::abs(got[i] - want[i]) <= tolerance) continue;
    std::printf("%s (%s): element %zu is %g, expected %g; %d -> %d channels, %d x %d x %d, stride %d\n", what,
                anynet::isa_name(isa), i, double(got[i]), double(want[i]), int(s.in_channels), int(s.out_channels),
                int(s.depth), int(s.height), int(s.width), int(s.stride));
    ++failures;
    return;
  }
}

template <class T>
void test(const ConvShape& s, bool fused) {
  const int64_t depth_stride = s.kernel_depth == 1 ? 1 : s.stride;
  const int64_t D = (s.depth - 1) / depth_stride + 1, H = (s.height - 1) / s.stride + 1,
                W = (s.width - 1) / s.stride + 1;
  const int64_t taps = s.kernel_depth * 9, in_plane = s.depth * s.height * s.width, out_plane = D * H * W;
  const auto input = random_values<T>(s.batch * s.in_channels * in_plane, 1);
  const auto weight = random_values<T>(s.out_channels * s.in_channels * taps, 2);
  const auto grad = random_values<T>(s.batch * s.out_channels * out_plane, 3);
  const auto bias = random_values<T>(s.out_channels, 4);
  const auto scale = random_values<T>(s.in_channels, 5), shift = random_values<T>(s.in_channels, 6);

  std::vector<T> out(grad.size()), grad_input(input.size()), grad_weight(weight.size()), grad_bias(bias.size());
  for (int64_t i = 0; i < static_cast<int64_t>(out.size()); ++i) {
    const int64_t x = i % W, y = i / W % H, z = i / W / H % D, o = i / out_plane % s.out_channels;
    const int64_t n = i / out_plane / s.out_channels;
    out[i] = fused ? bias[o] : T(0);
    grad_bias[o] += grad[i];
    for (int64_t c = 0; c < s.in_channels; ++c) {
      for (int64_t t = 0; t < taps; ++t) {
        const int64_t iz = s.kernel_depth == 1 ? z : z * s.stride + t / 9 - 1;
        const int64_t iy = y * s.stride + t / 3 % 3 - 1, ix = x * s.stride + t % 3 - 1;
        if (iz < 0 || iy < 0 || ix < 0 || iz >= s.depth || iy >= s.height || ix >= s.width) continue;
        const int64_t from = (n * s.in_channels + c) * in_plane + (iz * s.height + iy) * s.width + ix;
        const int64_t w = (o * s.in_channels + c) * taps + t;
        const T active = fused ? std::max(T(0), scale[c] * input[from] + shift[c]) : input[from];
        out[i] += weight[w] * active;
        if (!fused || input[from] > 0) grad_input[from] += weight[w] * grad[i];
        grad_weight[w] += active * grad[i];
      }
    }
    if (fused) out[i] = std::max(T(0), out[i]);
  }

  for (Isa isa : {Isa::baseline, Isa::avx2, Isa::avx512}) {
    if (!anynet::isa_available(isa)) continue;
    std::vector<T> result(out.size());
    anynet::conv(
        isa,
        anynet::Conv<T>{s, input.data(), weight.data(), fused ? bias.data() : nullptr, fused ? scale.data() : nullptr,
                        fused ? shift.data() : nullptr, fused, fused, result.data()},
        3);
    expect_near("conv", isa, s, result, out);
    std::vector<T> input_result(input.size());
    anynet::conv_backward_input(isa,
                                anynet::ConvBackwardInput<T>{s, grad.data(), weight.data(),
                                                             fused ? input.data() : nullptr, input_result.data()},
                                3);
    expect_near("conv_backward_input", isa, s, input_result, grad_input);
    std::vector<T> weight_result(weight.size()), bias_result(bias.size());
    anynet::conv_backward_weight(
        isa,
        anynet::ConvBackwardWeight<T>{s, grad.data(), input.data(), fused ? scale.data() : nullptr,
                                      fused ? shift.data() : nullptr, fused, weight_result.data(), bias_result.data()},
        3);
    expect_near("conv_backward_weight", isa, s, weight_result, grad_weight);
    expect_near("conv_backward_weight (bias)", isa, s, bias_result, grad_bias);
  }
}

}  // namespace

int main() {
  for (int64_t stride : {1, 2}) {
    for (int64_t kernel_depth : {1, 3}) {
      for (int64_t width : {1, 2, 4, 5, 8, 9, 15, 16, 17, 32, 33, 37, 51}) {
        for (int64_t out_channels : {1, 2, 3, 8}) {
          for (bool fused : {false, true}) {
            const int64_t height = 1 + (width + out_channels) % 7;
            const ConvShape shape{2,      3,     out_channels, kernel_depth == 1 ? 1 : 1 + width % 3,
                                  height, width, kernel_depth, stride};
            test<float>(shape, fused);
            test<double>(shape, fused);
          }
        }
      }
    }
    test<float>(ConvShape{3, 8, 12, 5, 23, 77, 3, stride}, false);  // large enough for several threads
    for (int64_t depth : {8, 9, 19}) {                              // planes that do not fit the caches at once
      test<float>(ConvShape{2, 3, 5, depth, 7, 37, 3, stride}, depth == 9);
    }
    for (int64_t depth : {1, 2, 3}) {  // enough channels for tiles, flat or not
      for (int64_t height : {2, 5}) {
        for (int64_t width : {16, 18, 35, 101})
          test<float>(ConvShape{2, 11, 18, depth, height, width, depth == 1 ? 1 : 3, stride}, depth == 2);
      }
    }
  }
  std::printf("%d failures\n", failures);
  return failures != 0;
}
