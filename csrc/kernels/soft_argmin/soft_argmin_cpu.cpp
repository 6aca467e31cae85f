#include <cmath>

#include "../common/parallel.h"
#include "../common/simd.h"
#include "soft_argmin.h"

namespace anynet::ANYNET_ISA {

template <class T>
void soft_argmin(const SoftArgmin<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t D = a.cost.size[1], H = a.cost.size[2], W = a.cost.size[3];
  const int64_t* stride = a.cost.stride;
  parallel_for(a.cost.size[0] * H, threads, [&](int64_t row) {
    const int64_t n = row / H, y = row % H;
    const T* cost = a.cost.data + n * stride[0] + y * stride[2];
    for (int64_t x = 0; x < W; ++x) {
      const T* c = cost + x * stride[3];
      A lowest = to_accumulator(c[0]);
      for (int64_t k = 1; k < D; ++k) {
        const A v = to_accumulator(c[k * stride[1]]);
        lowest = v < lowest ? v : lowest;
      }
      A sum = 0, weighted = 0;
      for (int64_t k = 0; k < D; ++k) {
        const A e = std::exp(lowest - to_accumulator(c[k * stride[1]]));
        sum += e;
        weighted += e * static_cast<A>(k);
      }
      a.out[row * W + x] = from_accumulator<T>(static_cast<A>(a.first) + weighted / sum);
    }
  });
}

template <class T>
void soft_argmin_backward(const SoftArgminBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t D = a.cost.size[1], H = a.cost.size[2], W = a.cost.size[3];
  const int64_t* stride = a.cost.stride;
  parallel_for(a.cost.size[0] * H, threads, [&](int64_t row) {
    const int64_t n = row / H, y = row % H;
    const T* cost = a.cost.data + n * stride[0] + y * stride[2];
    const T* grad = a.grad.data + n * a.grad.stride[0] + y * a.grad.stride[2];
    T* out = a.grad_cost + (n * D * H + y) * W;
    for (int64_t x = 0; x < W; ++x) {
      const T* c = cost + x * stride[3];
      A lowest = to_accumulator(c[0]);
      for (int64_t k = 1; k < D; ++k) {
        const A v = to_accumulator(c[k * stride[1]]);
        lowest = v < lowest ? v : lowest;
      }
      A sum = 0, weighted = 0;
      for (int64_t k = 0; k < D; ++k) {
        const A e = std::exp(lowest - to_accumulator(c[k * stride[1]]));
        sum += e;
        weighted += e * static_cast<A>(k);
      }
      const A mean = weighted / sum;
      const A g = to_accumulator(grad[x * a.grad.stride[3]]);
      for (int64_t k = 0; k < D; ++k) {
        const A p = std::exp(lowest - to_accumulator(c[k * stride[1]])) / sum;
        out[k * H * W + x] = from_accumulator<T>(-g * p * (static_cast<A>(k) - mean));
      }
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(soft_argmin, SoftArgmin)
ANYNET_INSTANTIATE_KERNEL(soft_argmin_backward, SoftArgminBackward)

}  // namespace anynet::ANYNET_ISA
