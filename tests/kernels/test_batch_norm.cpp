#include <type_traits>

#include "../../csrc/kernels/batch_norm/batch_norm.h"
#include "check.h"

using namespace anynet;

template <class T>
void test(Isa isa, int threads, int64_t N, int64_t C, int64_t P) {
  check::Random random;
  const check::Array<T, 3> input({N, C, P}, random), grad({N, C, P}, random);
  const check::Array<T, 1> weight({C}, random), bias({C}, random);
  const double eps = 1e-3;
  std::vector<double> means(C), variances(C), expected(N * C * P), expected_input(N * C * P), expected_weight(C),
      expected_bias(C);
  const double count = static_cast<double>(N * P);
  for (int64_t c = 0; c < C; ++c) {
    const auto over_pixels = [&](const auto& body) {
      for (int64_t n = 0; n < N; ++n) {
        for (int64_t p = 0; p < P; ++p) body(n, p);
      }
    };
    over_pixels([&](int64_t n, int64_t p) { means[c] += input.at(n, c, p) / count; });
    over_pixels([&](int64_t n, int64_t p) { variances[c] += std::pow(input.at(n, c, p) - means[c], 2) / count; });
    const double d = 1 / std::sqrt(variances[c] + eps);
    const auto away = [&](int64_t n, int64_t p) { return d * (input.at(n, c, p) - means[c]); };
    const auto before = [&](int64_t n, int64_t p) { return weight.at(c) * away(n, p) + bias.at(c); };
    const auto passed = [&](int64_t n, int64_t p) { return before(n, p) > 0 ? grad.at(n, c, p) : 0; };
    over_pixels([&](int64_t n, int64_t p) {
      expected[(n * C + c) * P + p] = std::fmax(0, before(n, p));
      expected_bias[c] += passed(n, p);
      expected_weight[c] += passed(n, p) * away(n, p);
    });
    over_pixels([&](int64_t n, int64_t p) {
      expected_input[(n * C + c) * P + p] =
          weight.at(c) * d * (passed(n, p) - (expected_bias[c] + away(n, p) * expected_weight[c]) / count);
    });
  }
  std::vector<T> out(N * C * P), mean(C), variance(C), grad_input(N * C * P), grad_weight(C), grad_bias(C);
  const T *x = input.view.data, *w = weight.view.data, *b = bias.view.data;
  batch_norm_relu(isa, BatchNormRelu<T>{N, C, P, x, w, b, eps, out.data(), mean.data(), variance.data()}, threads);
  check::near("mean", mean, means);
  check::near("variance", variance, variances);
  check::near("batch_norm_relu", out, expected);
  const BatchNormReluBackward<T> args{N,
                                      C,
                                      P,
                                      grad.view.data,
                                      x,
                                      w,
                                      b,
                                      mean.data(),
                                      variance.data(),
                                      eps,
                                      grad_input.data(),
                                      grad_weight.data(),
                                      grad_bias.data()};
  batch_norm_relu_backward(isa, args, threads);
  check::near("gradient of the input", grad_input, expected_input);
  check::near("gradient of the weight", grad_weight, expected_weight);
  check::near("gradient of the bias", grad_bias, expected_bias);
}

int main() {
  check::for_each_variant([](Isa isa, auto type, int threads) {
    using T = decltype(type);
    if constexpr (std::is_floating_point_v<T>) {
      test<T>(isa, threads, 2, 1, 1);
      test<T>(isa, threads, 1, 3, 2);
      test<T>(isa, threads, 2, 2, 67);
      test<T>(isa, threads, 3, 2, 4099);
      test<T>(isa, threads, 1, 1, 70000);
    }
  });
}
