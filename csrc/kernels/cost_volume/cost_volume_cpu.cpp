#include "../common/parallel.h"
#include "../common/sampling.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "cost_volume.h"

namespace anynet::ANYNET_ISA {

namespace {

/// Where a row samples: at index[x] - k for offset k, the same fraction for all.
template <class A>
struct Positions {
  Scratch<A> converted, fraction;
  Scratch<int32_t> index;

  explicit Positions(int64_t W) : converted(W), fraction(W), index(W) {}

  template <class T>
  void read(const View4<const T>& disparity, int64_t n, int64_t y, int64_t W, int64_t first, int64_t K) {
    const A* d = converted;
    if (disparity.data == nullptr) {
      fill_zero<A>(converted, W);
    } else {
      d = read_row(disparity.data + n * disparity.stride[0] + y * disparity.stride[2], disparity.stride[3], W,
                   static_cast<A*>(converted));
    }
    split_positions<A>(d, W, first, -2, static_cast<int32_t>(W + K - 1), index, fraction);
  }
};

}  // namespace

template <class T>
void cost_volume(const CostVolume<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  parallel_ranges(N * H, useful_threads(N * C * H * W * K, threads), [&](int64_t begin, int64_t end) {
    const int64_t pad = K + 1;  // zeros on both sides of the right row
    Scratch<A> left_row(W), padded(W + 2 * pad), sum(K * W);
    Positions<A> at(W);
    fill_zero<A>(padded, W + 2 * pad);
    A* const right = padded + pad;
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      at.read(a.disparity, n, y, W, a.first, K);
      fill_zero<A>(sum, K * W);
      for (int64_t c = 0; c < C; ++c) {
        const A* left = read_row(a.left.data + n * a.left.stride[0] + c * a.left.stride[1] + y * a.left.stride[2],
                                 a.left.stride[3], W, static_cast<A*>(left_row));
        const A* source = read_row(a.right.data + n * a.right.stride[0] + c * a.right.stride[1] + y * a.right.stride[2],
                                   a.right.stride[3], W, right);
        if (source != right) std::memcpy(right, source, W * sizeof(A));
        for (int64_t k = 0; k < K; ++k) {
          for (int64_t x = 0; x < W; ++x) {
            const A f = at.fraction[x];
            const int64_t i = at.index[x] - k;
            const A sample = a.disparity.data == nullptr ? right[i] : (1 - f) * right[i] + f * right[i + 1];
            const A difference = left[x] - sample;
            sum[k * W + x] += difference < 0 ? -difference : difference;
          }
        }
      }
      for (int64_t k = 0; k < K; ++k) write_row<T>(sum + k * W, W, a.out + ((n * K + k) * H + y) * W);
    }
  });
}

template <class T>
void cost_volume_backward(const CostVolumeBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  parallel_ranges(N * H, useful_threads(2 * N * C * H * W * K, threads), [&](int64_t begin, int64_t end) {
    const int64_t pad = K + 1;
    Scratch<A> left_row(W), padded(W + 2 * pad), grad(K * W), grad_left(W), scattered(W + 2 * pad), grad_disparity(W);
    Positions<A> at(W);
    fill_zero<A>(padded, W + 2 * pad);
    A* const right = padded + pad;
    A* const grad_right = scattered + pad;
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      at.read(a.disparity, n, y, W, a.first, K);
      for (int64_t k = 0; k < K; ++k) {
        const T* p = a.grad.data + n * a.grad.stride[0] + k * a.grad.stride[1] + y * a.grad.stride[2];
        const A* source = read_row(p, a.grad.stride[3], W, grad + k * W);
        if (source != grad + k * W) std::memcpy(grad + k * W, source, W * sizeof(A));
      }
      fill_zero<A>(grad_disparity, W);
      for (int64_t c = 0; c < C; ++c) {
        const A* left = read_row(a.left.data + n * a.left.stride[0] + c * a.left.stride[1] + y * a.left.stride[2],
                                 a.left.stride[3], W, static_cast<A*>(left_row));
        const A* source = read_row(a.right.data + n * a.right.stride[0] + c * a.right.stride[1] + y * a.right.stride[2],
                                   a.right.stride[3], W, right);
        if (source != right) std::memcpy(right, source, W * sizeof(A));
        fill_zero<A>(grad_left, W);
        fill_zero<A>(scattered, W + 2 * pad);
        for (int64_t k = 0; k < K; ++k) {
          for (int64_t x = 0; x < W; ++x) {
            const A f = at.fraction[x];
            const int64_t i = at.index[x] - k;
            const A sample = a.disparity.data == nullptr ? right[i] : (1 - f) * right[i] + f * right[i + 1];
            const A g = grad[k * W + x];
            const A gs = left[x] > sample ? g : left[x] < sample ? -g : 0;
            grad_left[x] += gs;
            grad_disparity[x] += gs * (right[i + 1] - right[i]);
            grad_right[i] -= gs * (1 - f);
            grad_right[i + 1] -= gs * f;
          }
        }
        write_row<T>(grad_left, W, a.grad_left + ((n * C + c) * H + y) * W);
        write_row<T>(grad_right, W, a.grad_right + ((n * C + c) * H + y) * W);
      }
      if (a.grad_disparity != nullptr) write_row<T>(grad_disparity, W, a.grad_disparity + (n * H + y) * W);
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(cost_volume, CostVolume)
ANYNET_INSTANTIATE_KERNEL(cost_volume_backward, CostVolumeBackward)

}  // namespace anynet::ANYNET_ISA
