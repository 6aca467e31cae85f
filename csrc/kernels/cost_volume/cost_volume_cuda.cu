// Without disparity, forward: a warp computes 128 pixels x 8 offsets (4 in double), 4 neighboring pixels per thread,
// in registers. Tiles of both rows lie in shared memory for a few channels at a time, so that the warps of a block,
// which have different offsets, read the features once for up to 128 offsets. With disparity, forward: one thread per
// pixel and 8 offsets; neighboring offsets share a sample's pixels. Backward: gathered, so each gradient is written
// once and always the same way.
#include <cmath>

#include "../common/cuda.h"
#include "../common/cuda_sampling.h"
#include "cost_volume.h"

namespace anynet::cuda {
namespace {

template <class A>
ANYNET_DEVICE A with_sign(A value, A sign) {
  return sign > 0 ? value : sign < 0 ? -value : 0;
}

// ------------------------------------------------------------------------------------------ without disparity, forward
constexpr int lane_pixels = 4;
constexpr int tile_pixels = 32 * lane_pixels;
constexpr int staged_channels = 4;
constexpr int most_groups = 16;
template <class T>
constexpr int lane_offsets = 32 / sizeof(accumulator_t<T>);

/// How a block's warps are dealt out: `groups` of offsets times `rows`.
struct Layout {
  int groups, rows;
  int64_t x_tiles, offset_tiles;
};

template <class T>
__global__ void __launch_bounds__(32 * most_groups, 1) forward_grid(CostVolume<T> a, Layout layout) {
  using A = accumulator_t<T>;
  constexpr int offsets = lane_offsets<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  const int lane = threadIdx.x, group = threadIdx.y % layout.groups, local_row = threadIdx.y / layout.groups;
  const int block_offsets = layout.groups * offsets, right_pixels = tile_pixels + block_offsets;
  int64_t block = blockIdx.x;
  const int64_t k_begin = block % layout.offset_tiles * block_offsets;
  block /= layout.offset_tiles;
  const int64_t x_begin = block % layout.x_tiles * tile_pixels;
  const int64_t row = block / layout.x_tiles * layout.rows + local_row;
  const bool in_image = row < N * H;
  const int64_t n = row / H, y = row % H;
  const int64_t right_begin = x_begin - a.first - (k_begin + block_offsets - 1);

  SharedMemory shared;
  A* const left =
      shared.take<A>(layout.rows * staged_channels * tile_pixels) + local_row * staged_channels * tile_pixels;
  A* const right =
      shared.take<A>(layout.rows * staged_channels * right_pixels) + local_row * staged_channels * right_pixels;

  A cost[offsets][lane_pixels] = {};
  for (int64_t c_begin = 0; c_begin < C; c_begin += staged_channels) {
    const int channels = static_cast<int>(C - c_begin < staged_channels ? C - c_begin : staged_channels);
    if (in_image) {
      const int first_thread = group * 32 + lane, threads = layout.groups * 32;
      for (int c = 0; c < channels; ++c) {
        const T* source = row_of(a.left, n, c_begin + c, y);
        for (int i = first_thread; i < tile_pixels; i += threads) {
          const int64_t x = x_begin + i;
          left[c * tile_pixels + i] = x < W ? read(source + x * a.left.stride[3]) : A(0);
        }
        source = row_of(a.right, n, c_begin + c, y);
        for (int i = first_thread; i < right_pixels; i += threads) {
          const int64_t x = right_begin + i;
          right[c * right_pixels + i] = x >= 0 && x < W ? read(source + x * a.right.stride[3]) : A(0);
        }
      }
    }
    __syncthreads();
    if (in_image) {
      for (int c = 0; c < channels; ++c) {
        // Offset k of pixel p lies at window[offsets - 1 - k + p].
        A l[lane_pixels], window[offsets + lane_pixels];
        copy_wide(left + c * tile_pixels + lane * lane_pixels, l);
        copy_wide(right + c * right_pixels + lane * lane_pixels + (layout.groups - 1 - group) * offsets, window);
#pragma unroll
        for (int k = 0; k < offsets; ++k) {
#pragma unroll
          for (int i = 0; i < lane_pixels; ++i) cost[k][i] += fabs(l[i] - window[offsets - 1 - k + i]);
        }
      }
    }
    __syncthreads();
  }

  const int64_t x = x_begin + lane * lane_pixels;
  if (!in_image || x >= W) return;
  constexpr int pack = wide<T> < lane_pixels ? wide<T> : lane_pixels;
  const bool packs = W % lane_pixels == 0 && reinterpret_cast<uintptr_t>(a.out) % (pack * sizeof(T)) == 0;
#pragma unroll
  for (int j = 0; j < offsets; ++j) {
    const int64_t k = k_begin + group * offsets + j;
    if (k >= K) break;
    T* out = a.out + ((n * K + k) * H + y) * W + x;
#pragma unroll
    for (int i = 0; i < lane_pixels; i += pack) {
      Pack<T, pack> values;
#pragma unroll
      for (int q = 0; q < pack; ++q) values.value[q] = from_accumulator<T>(apply(a.epilogue, n, cost[j][i + q]));
      if (packs) {
        write_pack(out + i, values);
      } else {
#pragma unroll
        for (int q = 0; q < pack; ++q) {
          if (x + i + q < W) out[i + q] = values.value[q];
        }
      }
    }
  }
}

// --------------------------------------------------------------------------------------------- with disparity, forward
constexpr int threads_per_block = 128;
constexpr int thread_offsets = 8;

template <class T>
__global__ void __launch_bounds__(threads_per_block) forward_disparity(CostVolume<T> a, int64_t offset_tiles) {
  using A = accumulator_t<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  const int64_t i = blockIdx.x / offset_tiles * threads_per_block + threadIdx.x;
  const int64_t k_begin = blockIdx.x % offset_tiles * thread_offsets;
  const int64_t row = i / W, n = row / H, y = row % H;
  if (n >= N) return;
  const int x = static_cast<int>(i % W), width = static_cast<int>(W);
  const A disparity = read(row_of(a.disparity, n, 0, y) + x * a.disparity.stride[3]);
  const Position<A> at = locate(x, disparity, a.first + k_begin, -2, width + thread_offsets);
  const T* left = row_of(a.left, n, 0, y) + x * a.left.stride[3];
  const T* right = row_of(a.right, n, 0, y);

  A cost[thread_offsets] = {};
  for (int64_t c = 0; c < C; ++c) {
    const A l = read(left + c * a.left.stride[1]);
    const T* r = right + c * a.right.stride[1];
    A next = pixel(r, a.right.stride[3], at.index + 1, width);
#pragma unroll
    for (int k = 0; k < thread_offsets; ++k) {
      if (k_begin + k < K) {
        const A here = pixel(r, a.right.stride[3], at.index - k, width);
        cost[k] += fabs(l - sample(at, here, next));
        next = here;
      }
    }
  }
#pragma unroll
  for (int k = 0; k < thread_offsets; ++k) {
    if (k_begin + k < K) {
      a.out[((n * K + k_begin + k) * H + y) * W + x] = from_accumulator<T>(apply(a.epilogue, n, cost[k]));
    }
  }
}

// ----------------------------------------------------------------------------------------- without disparity, backward
constexpr int backward_channels = 8;
constexpr int backward_offsets = 64;

/// Even blocks compute a tile of grad_left, odd ones the same tile of grad_right. Both are
/// sum_k g[k, at] sign(mine - others[x - shift_k]), where shift_k = first + k and at = x for the left image, and
/// shift_k = -(first + k) and at = x - shift_k for the right one.
template <class T>
__global__ void __launch_bounds__(threads_per_block) backward_grid(CostVolumeBackward<T> a) {
  using A = accumulator_t<T>;
  constexpr int staged = threads_per_block + backward_offsets;
  const int64_t C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  const bool for_left = blockIdx.x % 2 == 0;
  const int64_t x_tiles = (W + threads_per_block - 1) / threads_per_block, tile = blockIdx.x / 2;
  const int64_t row = tile / x_tiles, n = row / H, y = row % H;
  const int64_t x_begin = tile % x_tiles * threads_per_block, x = x_begin + threadIdx.x;
  const View4<const T>& mine = for_left ? a.left : a.right;
  const View4<const T>& others = for_left ? a.right : a.left;
  T* const result = for_left ? a.grad_left : a.grad_right;
  const T* grad = row_of(a.grad, n, 0, y);

  SharedMemory shared;
  A* const tile_of_others = shared.take<A>(backward_channels * staged);
  for (int64_t c_begin = 0; c_begin < C; c_begin += backward_channels) {
    A own[backward_channels], sum[backward_channels] = {};
#pragma unroll
    for (int c = 0; c < backward_channels; ++c) {
      own[c] = x < W && c_begin + c < C ? read(row_of(mine, n, c_begin + c, y) + x * mine.stride[3]) : A(0);
    }
    for (int64_t k_begin = 0; k_begin < K; k_begin += backward_offsets) {
      const int offsets = static_cast<int>(K - k_begin < backward_offsets ? K - k_begin : backward_offsets);
      const int64_t shift = a.first + k_begin;
      const int64_t others_begin = for_left ? x_begin - shift - (offsets - 1) : x_begin + shift;
      __syncthreads();
#pragma unroll
      for (int c = 0; c < backward_channels; ++c) {
        if (c_begin + c >= C) break;
        const T* source = row_of(others, n, c_begin + c, y);
        for (int i = threadIdx.x; i < threads_per_block + offsets - 1; i += threads_per_block) {
          const int64_t p = others_begin + i;
          tile_of_others[c * staged + i] = p >= 0 && p < W ? read(source + p * others.stride[3]) : A(0);
        }
      }
      __syncthreads();
      for (int k = 0; k < offsets; ++k) {
        const int64_t at = for_left ? x : x + shift + k;
        if (x >= W || at < 0 || at >= W) continue;
        const A g = read(grad + (k_begin + k) * a.grad.stride[1] + at * a.grad.stride[3]);
        const A* other = tile_of_others + threadIdx.x + (for_left ? offsets - 1 - k : k);
#pragma unroll
        for (int c = 0; c < backward_channels; ++c) {
          if (c_begin + c < C) sum[c] += with_sign(g, own[c] - other[c * staged]);
        }
      }
    }
    if (x < W) {
#pragma unroll
      for (int c = 0; c < backward_channels; ++c) {
        if (c_begin + c < C) result[((n * C + c_begin + c) * H + y) * W + x] = from_accumulator<T>(sum[c]);
      }
    }
  }
}

// -------------------------------------------------------------------------------------------- with disparity, backward
constexpr int gathered_channels = 4;

/// One warp per 32 pixels of a row: first as pixels of the left image, then, gathering, as pixels of the right one.
template <class T>
__global__ void __launch_bounds__(threads_per_block, 4) backward_disparity(CostVolumeBackward<T> a) {
  using A = accumulator_t<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3];
  const int K = static_cast<int>(a.count), width = static_cast<int>(W);
  const int64_t tiles = (W + 31) / 32;
  const int64_t warp = (static_cast<int64_t>(blockIdx.x) * threads_per_block + threadIdx.x) / 32;
  const int64_t row = warp / tiles, n = row / H, y = row % H;
  if (n >= N) return;
  const int begin = static_cast<int>(warp % tiles) * 32, x = begin + threadIdx.x % 32;

  const T* disparity = row_of(a.disparity, n, 0, y);
  const auto position = [&](int i) {
    return locate(i, read(disparity + i * a.disparity.stride[3]), a.first, -2, width + K);
  };
  const T* left = row_of(a.left, n, 0, y);
  const T* right = row_of(a.right, n, 0, y);
  const T* grad = row_of(a.grad, n, 0, y);
  const int64_t left_x = a.left.stride[3], right_x = a.right.stride[3], grad_x = a.grad.stride[3];

  A disparity_sum = 0;
  const Position<A> at = x < width ? position(x) : Position<A>{-2, 0};
  for (int64_t c_begin = 0; c_begin < C; c_begin += gathered_channels) {
    const int channels = static_cast<int>(C - c_begin < gathered_channels ? C - c_begin : gathered_channels);
    A l[gathered_channels], next[gathered_channels], sum[gathered_channels];
    if (x < width) {
#pragma unroll
      for (int c = 0; c < gathered_channels; ++c) {
        const bool real = c < channels;
        l[c] = real ? read(left + (c_begin + c) * a.left.stride[1] + x * left_x) : A(0);
        next[c] = real ? pixel(right + (c_begin + c) * a.right.stride[1], right_x, at.index + 1, width) : A(0);
        sum[c] = 0;
      }
      for (int k = 0; k < K; ++k) {
        const A g = read(grad + k * a.grad.stride[1] + x * grad_x);
#pragma unroll
        for (int c = 0; c < gathered_channels; ++c) {
          if (c >= channels) continue;
          const A here = pixel(right + (c_begin + c) * a.right.stride[1], right_x, at.index - k, width);
          const A signed_g = with_sign(g, l[c] - sample(at, here, next[c]));
          sum[c] += signed_g;
          disparity_sum += signed_g * (next[c] - here);
          next[c] = here;
        }
      }
#pragma unroll
      for (int c = 0; c < gathered_channels; ++c) {
        if (c < channels) a.grad_left[((n * C + c_begin + c) * H + y) * W + x] = from_accumulator<T>(sum[c]);
      }
    }

    A before[gathered_channels], here[gathered_channels], after[gathered_channels];
#pragma unroll
    for (int c = 0; c < gathered_channels; ++c) {
      const bool real = c < channels;
      const T* r = right + (c_begin + c) * a.right.stride[1];
      before[c] = real ? pixel(r, right_x, x - 1, width) : A(0);
      here[c] = real ? pixel(r, right_x, x, width) : A(0);
      after[c] = real ? pixel(r, right_x, x + 1, width) : A(0);
      sum[c] = 0;
    }
    for_each_sampler<A>(begin, width, K - 1, position, [&](int sampler, Position<A> from) {
      // This pixel is the lower one of the sample with offset k, and the upper one of the sample with offset k + 1.
      const int k = from.index - x;
      const bool lower = x < width && k >= 0 && k < K, upper = x < width && k + 1 >= 0 && k + 1 < K;
      const T* g = grad + k * a.grad.stride[1] + sampler * grad_x;
      const A lower_g = lower ? read(g) : A(0), upper_g = upper ? read(g + a.grad.stride[1]) : A(0);
#pragma unroll
      for (int c = 0; c < gathered_channels; ++c) {
        if (c >= channels) continue;
        const A value = read(left + (c_begin + c) * a.left.stride[1] + sampler * left_x);
        if (lower) sum[c] -= (1 - from.fraction) * with_sign(lower_g, value - sample(from, here[c], after[c]));
        if (upper) sum[c] -= from.fraction * with_sign(upper_g, value - sample(from, before[c], here[c]));
      }
    });
    if (x < width) {
#pragma unroll
      for (int c = 0; c < gathered_channels; ++c) {
        if (c < channels) a.grad_right[((n * C + c_begin + c) * H + y) * W + x] = from_accumulator<T>(sum[c]);
      }
    }
  }
  if (x < width) a.grad_disparity[row * W + x] = from_accumulator<T>(disparity_sum);
}

/// Far outside any row it does not matter how far; this keeps positions from overflowing.
int64_t limit_first(int64_t first) {
  constexpr int64_t far = int64_t{1} << 40;
  return first < -far ? -far : first > far ? far : first;
}

}  // namespace

template <class T>
void cost_volume(const CostVolume<T>& args, Stream stream) {
  using A = accumulator_t<T>;
  CostVolume<T> a = args;
  const int64_t* size = a.left.size;
  check_row("cost_volume", size[3], a.count);
  const int64_t rows = size[0] * size[2];
  if (a.disparity.data != nullptr) {
    const int64_t offset_tiles = ceil_div(a.count, thread_offsets);
    launch("cost_volume", forward_disparity<T>, ceil_div(rows * size[3], threads_per_block) * offset_tiles,
           threads_per_block, 0, stream, a, offset_tiles);
    return;
  }
  a.first = limit_first(a.first);
  constexpr int offsets = lane_offsets<T>;
  const int64_t groups = ceil_div(a.count, offsets);
  Layout layout;
  layout.groups = static_cast<int>(groups < most_groups ? groups : most_groups);
  layout.rows = layout.groups < 4 ? 4 / layout.groups : 1;
  layout.x_tiles = ceil_div(size[3], tile_pixels);
  layout.offset_tiles = ceil_div(groups, layout.groups);
  const int staged = layout.rows * staged_channels;
  const int64_t shared =
      shared_bytes<A>(staged * tile_pixels) + shared_bytes<A>(staged * (tile_pixels + layout.groups * offsets));
  launch("cost_volume", forward_grid<T>, ceil_div(rows, layout.rows) * layout.x_tiles * layout.offset_tiles,
         dim3(32, layout.groups * layout.rows), shared, stream, a, layout);
}

template <class T>
void cost_volume_backward(const CostVolumeBackward<T>& args, Stream stream) {
  using A = accumulator_t<T>;
  CostVolumeBackward<T> a = args;
  const int64_t* size = a.left.size;
  check_row("cost_volume_backward", size[3], a.count);
  const int64_t rows = size[0] * size[2];
  if (a.disparity.data != nullptr) {
    launch("cost_volume_backward", backward_disparity<T>,
           ceil_div(rows * ceil_div(size[3], 32), threads_per_block / 32), threads_per_block, 0, stream, a);
  } else {
    a.first = limit_first(a.first);
    launch("cost_volume_backward", backward_grid<T>, 2 * rows * ceil_div(size[3], threads_per_block), threads_per_block,
           shared_bytes<A>(backward_channels * (threads_per_block + backward_offsets)), stream, a);
  }
}

ANYNET_INSTANTIATE_CUDA_KERNEL(cost_volume, CostVolume)
ANYNET_INSTANTIATE_CUDA_KERNEL(cost_volume_backward, CostVolumeBackward)

}  // namespace anynet::cuda
