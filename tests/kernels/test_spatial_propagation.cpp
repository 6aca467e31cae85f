#include "../../csrc/kernels/spatial_propagation/spatial_propagation.h"
#include "check.h"

using namespace anynet;

template <class T>
void test(Isa isa, int threads, int64_t N, int64_t C, int64_t H, int64_t W, int direction, int64_t spread) {
  check::Random random;
  const check::Array<T> input({N, C, H, W}, random, spread), grad({N, C, H, W}, random, spread);
  const check::Array<T, 5> gates({N, 3, C, H, W}, [&] { return 0.3 * random(); }, spread);
  const bool horizontal = direction < 2;
  const int64_t steps = horizontal ? W : H, R = horizontal ? H : W;
  std::vector<double> h(N * C * H * W), e(h.size()), grad_input(h.size()), grad_gates(3 * h.size());
  for (int64_t n = 0; n < N; ++n) {
    for (int64_t c = 0; c < C; ++c) {
      // Element r of the line at step t.
      const auto row = [&](int64_t t, int64_t r) { return horizontal ? r : direction == 2 ? t : H - 1 - t; };
      const auto column = [&](int64_t t, int64_t r) { return !horizontal ? r : direction == 0 ? t : W - 1 - t; };
      const auto place = [&](int64_t t, int64_t r) { return ((n * C + c) * H + row(t, r)) * W + column(t, r); };
      const auto gate = [&](int64_t j, int64_t t, int64_t r) {
        const bool inside = t > 0 && r + j - 1 >= 0 && r + j - 1 < R;
        return inside ? gates.at(n, j, c, row(t, r), column(t, r)) : 0.0;
      };
      for (int64_t t = 0; t < steps; ++t) {
        for (int64_t r = 0; r < R; ++r) {
          double value = input.at(n, c, row(t, r), column(t, r));
          const double x = value;
          for (int64_t j = 0; j < 3; ++j) {
            if (gate(j, t, r) != 0) value += gate(j, t, r) * (h[place(t - 1, r + j - 1)] - x);
          }
          h[place(t, r)] = value;
        }
      }
      for (int64_t t = steps - 1; t >= 0; --t) {
        for (int64_t r = 0; r < R; ++r) {
          double value = grad.at(n, c, row(t, r), column(t, r));
          for (int64_t j = 0; j < 3; ++j) {
            const int64_t q = r - j + 1;  // whose gate j reads element r
            if (t + 1 < steps && q >= 0 && q < R) value += gate(j, t + 1, q) * e[place(t + 1, q)];
          }
          e[place(t, r)] = value;
          double keep = 1;
          for (int64_t j = 0; j < 3; ++j) {
            keep -= gate(j, t, r);
            const bool inside = t > 0 && r + j - 1 >= 0 && r + j - 1 < R;
            const double x = input.at(n, c, row(t, r), column(t, r));
            const int64_t at = ((n * 3 + j) * C + c) * H * W + row(t, r) * W + column(t, r);
            grad_gates[at] = inside ? value * (h[place(t - 1, r + j - 1)] - x) : 0;
          }
          grad_input[place(t, r)] = keep * value;
        }
      }
    }
  }
  std::vector<T> out(h.size()), got_input(h.size()), got_gates(grad_gates.size());
  spatial_propagation(isa, SpatialPropagation<T>{input.view, gates.view, direction, out.data()}, threads);
  check::near("spatial_propagation", out, h);
  if constexpr (std::is_same_v<T, float>) {  // the deployed network's: normalized as it reads them
    check::Array<T, 5> unscaled = gates, scaled = gates;
    for (int64_t i = 0; i < N * C * H * W; ++i) {
      const int64_t first = (i / (C * H * W) * 3 * C * H * W + i % (C * H * W)) * spread, step = C * H * W * spread;
      double sum = 1e-8;
      for (int64_t j = 0; j < 3; ++j) sum += std::fabs(gates.values[first + j * step]);
      for (int64_t j = 0; j < 3; ++j)
        scaled.values[first + j * step] = static_cast<float>(gates.values[first + j * step] / sum);
    }
    unscaled.view.data = unscaled.values.data(), scaled.view.data = scaled.values.data();
    std::vector<T> normalized(h.size());
    spatial_propagation(isa, SpatialPropagation<T>{input.view, scaled.view, direction, out.data()}, threads);
    spatial_propagation(isa, SpatialPropagation<T>{input.view, unscaled.view, direction, normalized.data(), true},
                        threads);
    check::near("spatial_propagation, normalized", normalized, std::vector<double>(out.begin(), out.end()));
    spatial_propagation(isa, SpatialPropagation<T>{input.view, gates.view, direction, out.data()}, threads);
  }
  View4<const T> out_view{out.data(), {N, C, H, W}, {C * H * W, H * W, W, 1}};
  spatial_propagation_backward(isa,
                               SpatialPropagationBackward<T>{grad.view, input.view, gates.view, out_view, direction,
                                                             got_input.data(), got_gates.data()},
                               threads);
  check::near("spatial_propagation_backward input", got_input, grad_input);
  check::near("spatial_propagation_backward gates", got_gates, grad_gates);
}

int main() {
  check::for_each_variant([](Isa isa, auto type, int threads) {
    using T = decltype(type);
    for (int direction = 0; direction < 4; ++direction) {
      test<T>(isa, threads, 1, 1, 1, 1, direction, 1);
      test<T>(isa, threads, 2, 3, 3, 7, direction, 1);
      test<T>(isa, threads, 1, 2, 1, 33, direction, 1);
      test<T>(isa, threads, 1, 2, 33, 1, direction, 1);
      test<T>(isa, threads, 1, 2, 19, 37, direction, 2);
      test<T>(isa, threads, 4, 2, 60, 70, direction, 1);
      test<T>(isa, threads, 0, 2, 3, 4, direction, 1);
      test<T>(isa, threads, 1, 2, 0, 4, direction, 1);
      test<T>(isa, threads, 1, 2, 3, 0, direction, 1);
    }
  });
}
