#include "../common/parallel.h"
#include "../common/sampling.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "warp.h"

namespace anynet::ANYNET_ISA {

namespace {

template <class A, class T>
void read_positions(Positions<A>& at, const View4<const T>& disparity, int64_t n, int64_t y) {
  const T* p = disparity.data + n * disparity.stride[0] + y * disparity.stride[2];
  at.read(p, disparity.stride[3], 0, -2, static_cast<int32_t>(disparity.size[3]));
}

}  // namespace

template <class T>
void warp(const Warp<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.image.size[0], C = a.image.size[1], H = a.image.size[2], W = a.image.size[3];
  if (W == 0) return;
  parallel_ranges(N * H, useful_threads(threads, N, C, H, W, 4), [&](int64_t begin, int64_t end) {
    Scratch<A> padded(W + 2 * sampled_beside<A>);
    Positions<A> at(W);
    fill_zero<A>(padded, W + 2 * sampled_beside<A>);
    A* const row = padded + sampled_beside<A>;
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      read_positions(at, a.disparity, n, y);
      for (int64_t c = 0; c < C; ++c) {
        const T* image = a.image.data + n * a.image.stride[0] + c * a.image.stride[1] + y * a.image.stride[2];
        copy_row(image, a.image.stride[3], W, row);
        T* const out = a.out + ((n * C + c) * H + y) * W;
        for (int64_t x = 0; x < W; x += lanes<A>) {
          gather_at(at, x, [&](const auto& gather) {
            const vec<A> f = load(at.fraction + x);
            vec<A> sides[2];
            gather.template descending<2>(row, 1, sides);
            write_vector<T>((1 - f) * sides[1] + f * sides[0], W - x < lanes<A> ? W - x : lanes<A>, out + x);
          });
        }
      }
    }
  });
}

template <class T>
void warp_backward(const WarpBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.image.size[0], C = a.image.size[1], H = a.image.size[2], W = a.image.size[3];
  if (W == 0) return;
  parallel_ranges(N * H, useful_threads(threads, N, C, H, W, 8), [&](int64_t begin, int64_t end) {
    const int64_t padded_width = W + 2 * sampled_beside<A>, vectors_width = round_up(W, lanes<A>);
    Scratch<A> padded(padded_width), scattered(padded_width), grad(vectors_width), grad_disparity(vectors_width);
    Positions<A> at(W);
    fill_zero<A>(padded, padded_width);
    fill_zero<A>(grad, vectors_width);
    A *const row = padded + sampled_beside<A>, *const grad_image = scattered + sampled_beside<A>;
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      read_positions(at, a.disparity, n, y);
      fill_zero<A>(grad_disparity, W);
      for (int64_t c = 0; c < C; ++c) {
        const T* image = a.image.data + n * a.image.stride[0] + c * a.image.stride[1] + y * a.image.stride[2];
        const T* arriving = a.grad.data + n * a.grad.stride[0] + c * a.grad.stride[1] + y * a.grad.stride[2];
        copy_row(image, a.image.stride[3], W, row);
        copy_row(arriving, a.grad.stride[3], W, static_cast<A*>(grad));
        for (int64_t x = 0; x < W; x += lanes<A>) {
          gather_at(at, x, [&](const auto& gather) {
            vec<A> sides[2];
            gather.template descending<2>(row, 1, sides);
            store(grad_disparity + x, load(grad_disparity + x) - load(grad + x) * (sides[0] - sides[1]));
          });
        }
        fill_zero<A>(scattered, padded_width);
        for (int64_t x = 0; x < W; ++x) {
          const A right = grad[x] * at.fraction[x];
          grad_image[at.index[x]] += grad[x] * (1 - at.fraction[x]);
          grad_image[at.index[x] + 1] += right;
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
