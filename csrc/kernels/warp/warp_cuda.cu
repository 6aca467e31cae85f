// Forward: one thread per pixel, which samples all channels; a warp's loads and stores are neighbors.
// Backward: one warp per 32 pixels of a row. Each lane gathers what its image pixel received (see for_each_sampler).
#include <cmath>

#include "../common/cuda.h"
#include "../common/cuda_sampling.h"
#include "warp.h"

namespace anynet::cuda {
namespace {

constexpr int threads_per_block = 128;
constexpr int channels_at_once = 4;

template <class T>
__global__ void __launch_bounds__(threads_per_block) forward(Warp<T> a) {
  using A = accumulator_t<T>;
  const int64_t N = a.image.size[0], C = a.image.size[1], H = a.image.size[2], W = a.image.size[3];
  const int64_t i = static_cast<int64_t>(blockIdx.x) * threads_per_block + threadIdx.x;
  const int64_t row = i / W, n = row / H, y = row % H;
  if (n >= N) return;
  const int x = static_cast<int>(i % W), width = static_cast<int>(W);
  const A disparity = read(row_of(a.disparity, n, 0, y) + x * a.disparity.stride[3]);
  const Position<A> at = locate(x, disparity, 0, -2, width);
  const T* image = row_of(a.image, n, 0, y);
  T* out = a.out + (n * C * H + y) * W + x;
#pragma unroll 4
  for (int64_t c = 0; c < C; ++c) {
    const T* source = image + c * a.image.stride[1];
    const A here = pixel(source, a.image.stride[3], at.index, width);
    const A next = pixel(source, a.image.stride[3], at.index + 1, width);
    out[c * H * W] = from_accumulator<T>(sample(at, here, next));
  }
}

template <class T>
__global__ void __launch_bounds__(threads_per_block) backward(WarpBackward<T> a) {
  using A = accumulator_t<T>;
  const int64_t N = a.image.size[0], C = a.image.size[1], H = a.image.size[2], W = a.image.size[3];
  const int64_t tiles = (W + 31) / 32;
  const int64_t warp = (static_cast<int64_t>(blockIdx.x) * threads_per_block + threadIdx.x) / 32;
  const int64_t row = warp / tiles, n = row / H, y = row % H;
  if (n >= N) return;
  const int begin = static_cast<int>(warp % tiles) * 32, x = begin + threadIdx.x % 32, width = static_cast<int>(W);

  const T* disparity = row_of(a.disparity, n, 0, y);
  const auto position = [&](int i) { return locate(i, read(disparity + i * a.disparity.stride[3]), 0, -2, width); };
  const T* image = row_of(a.image, n, 0, y);
  const T* grad = row_of(a.grad, n, 0, y);

  if (x < width) {
    const Position<A> at = position(x);
    A sum = 0;
#pragma unroll 4
    for (int64_t c = 0; c < C; ++c) {
      const T* source = image + c * a.image.stride[1];
      const A step =
          pixel(source, a.image.stride[3], at.index + 1, width) - pixel(source, a.image.stride[3], at.index, width);
      sum -= read(grad + c * a.grad.stride[1] + x * a.grad.stride[3]) * step;
    }
    a.grad_disparity[row * W + x] = from_accumulator<T>(sum);
  }

  for (int64_t c = 0; c < C; c += channels_at_once) {
    A sum[channels_at_once] = {};
    for_each_sampler<A>(begin, width, 0, position, [&](int sampler, Position<A> at) {
      const A weight = x == at.index ? 1 - at.fraction : x == at.index + 1 ? at.fraction : 0;
#pragma unroll
      for (int i = 0; i < channels_at_once; ++i) {
        // The same address in every lane. Lanes that this pixel did not sample must not add 0 * infinity.
        if (c + i < C && weight != 0)
          sum[i] += weight * read(grad + (c + i) * a.grad.stride[1] + sampler * a.grad.stride[3]);
      }
    });
    if (x < width) {
#pragma unroll
      for (int i = 0; i < channels_at_once; ++i) {
        if (c + i < C) a.grad_image[((n * C + c + i) * H + y) * W + x] = from_accumulator<T>(sum[i]);
      }
    }
  }
}

}  // namespace

template <class T>
void warp(const Warp<T>& a, Stream stream) {
  const int64_t* size = a.image.size;
  check_row("warp", size[3], 0);
  launch("warp", forward<T>, ceil_div(size[0] * size[2] * size[3], threads_per_block), threads_per_block, 0, stream, a);
}

template <class T>
void warp_backward(const WarpBackward<T>& a, Stream stream) {
  const int64_t* size = a.image.size;
  check_row("warp_backward", size[3], 0);
  const int64_t warps = size[0] * size[2] * ceil_div(size[3], 32);
  launch("warp_backward", backward<T>, ceil_div(warps, threads_per_block / 32), threads_per_block, 0, stream, a);
}

ANYNET_INSTANTIATE_CUDA_KERNEL(warp, Warp)
ANYNET_INSTANTIATE_CUDA_KERNEL(warp_backward, WarpBackward)

}  // namespace anynet::cuda
