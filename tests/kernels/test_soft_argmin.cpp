#include "../../csrc/kernels/soft_argmin/soft_argmin.h"
#include "check.h"

using namespace anynet;

template <class T>
void test(Isa isa, int threads, int64_t N, int64_t D, int64_t H, int64_t W, int64_t first, int64_t spread) {
  check::Random random;
  const check::Array<T> cost({N, D, H, W}, [&] { return 4 * random(); }, spread);
  const check::Array<T> grad({N, 1, H, W}, random, spread);
  std::vector<double> expected(N * H * W), expected_grad(N * D * H * W);
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t y = 0; y < H; ++y) {
      for (int64_t x = 0; x < W; ++x) {
        double sum = 0, weighted = 0;
        for (int64_t k = 0; k < D; ++k) {
          const double e = std::exp(-cost.at(n, k, y, x));
          sum += e;
          weighted += e * static_cast<double>(first + k);
        }
        const double mean = weighted / sum;
        expected[(n * H + y) * W + x] = mean;
        for (int64_t k = 0; k < D; ++k) {
          expected_grad[((n * D + k) * H + y) * W + x] = -grad.at(n, int64_t{0}, y, x) *
                                                         std::exp(-cost.at(n, k, y, x)) / sum *
                                                         (static_cast<double>(first + k) - mean);
        }
      }
    }
  }
  std::vector<T> out(expected.size()), grad_cost(expected_grad.size());
  soft_argmin(isa, SoftArgmin<T>{cost.view, first, out.data()}, threads);
  check::near("soft_argmin", out, expected);
  soft_argmin_backward(isa, SoftArgminBackward<T>{grad.view, cost.view, first, grad_cost.data()}, threads);
  check::near("soft_argmin_backward", grad_cost, expected_grad);
}

/// NaN and infinite costs: their pixel alone is undefined, and nothing overflows (UBSan).
template <class T>
void test_special(Isa isa, int threads) {
  check::Random random;
  check::Array<T> cost({1, 4, 3, 37}, random), grad({1, 1, 3, 37}, random);
  std::vector<T> before(3 * 37), after(3 * 37), grad_cost(4 * 3 * 37);
  soft_argmin(isa, SoftArgmin<T>{cost.view, INT64_MIN / 2, before.data()}, threads);
  soft_argmin(isa, SoftArgmin<T>{cost.view, 0, before.data()}, threads);
  for (double special : {double{NAN}, double{INFINITY}, -double{INFINITY}}) {
    cost.values[3 * 37 + 5] = check::from_double<T>(special);
    soft_argmin(isa, SoftArgmin<T>{cost.view, 0, after.data()}, threads);
    soft_argmin_backward(isa, SoftArgminBackward<T>{grad.view, cost.view, 0, grad_cost.data()}, threads);
    for (int64_t i = 0; i < 3 * 37; ++i) {
      if (i != 5) check::near("soft_argmin beside a special cost", after[i], check::to_double(before[i]), i);
    }
  }
}

int main() {
  check::for_each_variant([](Isa isa, auto type, int threads) {
    using T = decltype(type);
    test<T>(isa, threads, 1, 1, 1, 1, 3, 1);
    test<T>(isa, threads, 2, 5, 3, 7, -2, 1);
    test<T>(isa, threads, 1, 12, 4, 67, 0, 2);
    test<T>(isa, threads, 1, 48, 60, 130, 0, 1);
    test<T>(isa, threads, 0, 3, 2, 5, 0, 1);
    test<T>(isa, threads, 1, 3, 2, 0, 0, 1);
    test_special<T>(isa, threads);
  });
}
