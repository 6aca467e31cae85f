#include "../common/parallel.h"
#include "../common/sampling.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "warp.h"

namespace anynet::ANYNET_ISA {

template <class T>
void warp(const Warp<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.image.size[0], C = a.image.size[1], H = a.image.size[2], W = a.image.size[3];
  parallel_ranges(N * H, useful_threads(N * C * H * W, threads), [&](int64_t begin, int64_t end) {
    // The row with two zeros before and after it.
    Scratch<A> converted(W), padded(W + 4), fraction(W), out(W);
    Scratch<int32_t> index(W);
    fill_zero<A>(padded, W + 4);
    A* const row = padded + 2;
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      const A* disparity = read_row(a.disparity.data + n * a.disparity.stride[0] + y * a.disparity.stride[2],
                                    a.disparity.stride[3], W, static_cast<A*>(converted));
      split_positions<A>(disparity, W, 0, -2, static_cast<int32_t>(W), index, fraction);
      for (int64_t c = 0; c < C; ++c) {
        const T* image = a.image.data + n * a.image.stride[0] + c * a.image.stride[1] + y * a.image.stride[2];
        const A* source = read_row(image, a.image.stride[3], W, row);
        if (source != row) std::memcpy(row, source, W * sizeof(A));
        for (int64_t x = 0; x < W; ++x) {
          out[x] = (1 - fraction[x]) * row[index[x]] + fraction[x] * row[index[x] + 1];
        }
        write_row<T>(out, W, a.out + ((n * C + c) * H + y) * W);
      }
    }
  });
}

template <class T>
void warp_backward(const WarpBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.image.size[0], C = a.image.size[1], H = a.image.size[2], W = a.image.size[3];
  parallel_ranges(N * H, useful_threads(2 * N * C * H * W, threads), [&](int64_t begin, int64_t end) {
    Scratch<A> converted(W), padded(W + 4), fraction(W), gathered(W), scattered(W + 4), grad_disparity(W);
    Scratch<int32_t> index(W);
    fill_zero<A>(padded, W + 4);
    A* const row = padded + 2;
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      const A* disparity = read_row(a.disparity.data + n * a.disparity.stride[0] + y * a.disparity.stride[2],
                                    a.disparity.stride[3], W, static_cast<A*>(converted));
      split_positions<A>(disparity, W, 0, -2, static_cast<int32_t>(W), index, fraction);
      fill_zero<A>(grad_disparity, W);
      for (int64_t c = 0; c < C; ++c) {
        const T* image = a.image.data + n * a.image.stride[0] + c * a.image.stride[1] + y * a.image.stride[2];
        const A* source = read_row(image, a.image.stride[3], W, row);
        if (source != row) std::memcpy(row, source, W * sizeof(A));
        const A* grad = read_row(a.grad.data + n * a.grad.stride[0] + c * a.grad.stride[1] + y * a.grad.stride[2],
                                 a.grad.stride[3], W, static_cast<A*>(gathered));
        fill_zero<A>(scattered, W + 4);
        A* const grad_image = scattered + 2;
        for (int64_t x = 0; x < W; ++x) {
          const int32_t i = index[x];
          grad_disparity[x] -= grad[x] * (row[i + 1] - row[i]);
          grad_image[i] += grad[x] * (1 - fraction[x]);
          grad_image[i + 1] += grad[x] * fraction[x];
        }
        write_row<T>(grad_image, W, a.grad_image + ((n * C + c) * H + y) * W);
      }
      write_row<T>(grad_disparity, W, a.grad_disparity + (n * H + y) * W);
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(warp, Warp)
ANYNET_INSTANTIATE_KERNEL(warp_backward, WarpBackward)

}  // namespace anynet::ANYNET_ISA
