// One thread per output pixel and up to 8 output channels. A block has 32 x 4 pixels of one slice; what they see of a
// few input channels lies in shared memory, affine and ReLU applied, beside the weights, which all threads read
// together. Pairs: a block has 16 x 8 pixels of all slices; all channels of the input, and of what lies between, are in
// shared memory, with a border of two pixels and one. The border is computed by both blocks beside it.
#include "../common/cuda.h"
#include "conv.h"

namespace anynet::cuda {
namespace {

constexpr int tile_columns = 32, tile_rows = 4, threads_per_block = tile_columns * tile_rows;
template <class T>
constexpr int staged_channels = 16 / sizeof(T);

/// What a launch derives from a shape.
struct Grid {
  int64_t depth, height, width;          // of the output
  int64_t x_tiles, y_tiles, out_chunks;  // blocks
  int rows, columns;                     // of a tile of the input
  int taps;                              // of the kernel
};

/// sums[o] += the 3x3 around `window`, times weights [9][Outputs].
template <class T, int Outputs>
ANYNET_DEVICE void add_taps(const T* window, int columns, const T* weights, T (&sums)[Outputs]) {
#pragma unroll
  for (int tap = 0; tap < 9; ++tap) {
    const T value = window[tap / 3 * columns + tap % 3];
    T weight[Outputs];
    copy_wide(weights + tap * Outputs, weight);
#pragma unroll
    for (int o = 0; o < Outputs; ++o) sums[o] += value * weight[o];
  }
}

template <class T, int Outputs>
__global__ void __launch_bounds__(threads_per_block, 4) forward(Conv<T> a, Grid grid) {
  const ConvShape& s = a.shape;
  int64_t block = blockIdx.x;
  const int64_t x_begin = block % grid.x_tiles * tile_columns;
  block /= grid.x_tiles;
  const int64_t y_begin = block % grid.y_tiles * tile_rows;
  block /= grid.y_tiles;
  const int64_t z = block % grid.depth;
  block /= grid.depth;
  const int64_t o_begin = block % grid.out_chunks * Outputs, n = block / grid.out_chunks;
  const int column = threadIdx.x, row = threadIdx.y, thread = row * tile_columns + column;
  const int stride = static_cast<int>(s.stride), slices = static_cast<int>(s.kernel_depth);
  const int tile = grid.rows * grid.columns, z_stride = slices == 3 ? stride : 1;

  SharedMemory shared;
  T* const input = shared.take<T>(staged_channels<T> * slices * tile);          // [channel][slice][row][column]
  T* const weights = shared.take<T>(staged_channels<T> * grid.taps * Outputs);  // [channel][tap][output]
  T sums[Outputs];
#pragma unroll
  for (int o = 0; o < Outputs; ++o) {
    sums[o] = a.bias != nullptr && o_begin + o < s.out_channels ? read(a.bias + o_begin + o) : T(0);
  }
  for (int64_t c_begin = 0; c_begin < s.in_channels; c_begin += staged_channels<T>) {
    const int left = static_cast<int>(s.in_channels - c_begin);
    const int channels = left < staged_channels<T> ? left : staged_channels<T>;
    for (int i = thread; i < tile; i += threads_per_block) {
      const int64_t y = y_begin * stride + i / grid.columns - 1, x = x_begin * stride + i % grid.columns - 1;
      const bool inside = y >= 0 && y < s.height && x >= 0 && x < s.width;
      for (int p = 0; p < channels * slices; ++p) {
        const int64_t c = c_begin + p / slices, from = z * z_stride + p % slices - slices / 2;
        T value = 0;
        if (inside && from >= 0 && from < s.depth) {
          value = read(a.input + (((n * s.in_channels + c) * s.depth + from) * s.height + y) * s.width + x);
          if (a.scale != nullptr) value = read(a.scale + c) * value + read(a.shift + c);
          if (a.relu_in) value = relu(value);
        }
        input[p * tile + i] = value;
      }
    }
    for (int i = thread; i < channels * grid.taps * Outputs; i += threads_per_block) {
      const int64_t o = o_begin + i % Outputs;
      const T* kernel = a.weight + (o * s.in_channels + c_begin) * grid.taps;
      weights[i] = o < s.out_channels ? read(kernel + i / Outputs) : T(0);
    }
    __syncthreads();
    const T* window = input + row * stride * grid.columns + column * stride;
    for (int p = 0; p < channels * slices; ++p) {
      add_taps(window + p * tile, grid.columns, weights + p * 9 * Outputs, sums);
    }
    __syncthreads();
  }
  const int64_t y = y_begin + row, x = x_begin + column;
  if (y >= grid.height || x >= grid.width) return;
#pragma unroll
  for (int o = 0; o < Outputs; ++o) {
    if (o_begin + o >= s.out_channels) break;
    const int64_t slice = (n * s.out_channels + o_begin + o) * grid.depth + z;
    a.out[(slice * grid.height + y) * grid.width + x] = a.relu_out ? relu(sums[o]) : sums[o];
  }
}

template <class T, int Outputs>
void run(const Conv<T>& a, Stream stream) {
  const ConvShape& s = a.shape;
  const auto strided = [&](int64_t size) { return (size - 1) / s.stride + 1; };
  const int stride = static_cast<int>(s.stride), taps = static_cast<int>(9 * s.kernel_depth);
  Grid grid;
  grid.depth = s.kernel_depth == 3 ? strided(s.depth) : s.depth;
  grid.height = strided(s.height);
  grid.width = strided(s.width);
  grid.x_tiles = ceil_div(grid.width, tile_columns);
  grid.y_tiles = ceil_div(grid.height, tile_rows);
  grid.out_chunks = ceil_div(s.out_channels, Outputs);
  grid.rows = (tile_rows - 1) * stride + 3;
  grid.columns = (tile_columns - 1) * stride + 3;
  grid.taps = taps;
  const int64_t staged = staged_channels<T>;
  launch("conv", forward<T, Outputs>, s.batch * grid.out_chunks * grid.depth * grid.y_tiles * grid.x_tiles,
         dim3(tile_columns, tile_rows),
         shared_bytes<T>(staged * s.kernel_depth * grid.rows * grid.columns) + shared_bytes<T>(staged * taps * Outputs),
         stream, a, grid);
}

// --------------------------------------------------------------------------------------------------------------- pairs
constexpr int pair_columns = 16, pair_rows = 8, pair_outputs = 4;
constexpr int64_t pair_shared = 48 * 1024;  // bytes that every GPU gives without being asked

/// One convolution from shared memory, input [channels][depth][rows + 2][columns + 2]: write(o, z, y, x, sums) takes
/// the sums of the channels o to o + 3 of each of [depth][rows][columns]. `staged` has room for four channels' weights.
template <class T, class Write>
ANYNET_DEVICE void convolve(const T* input, int channels, int depth, int rows, int columns, int slices, const T* weight,
                            const T* bias, int out_channels, T* staged, const Write& write) {
  constexpr int outputs = pair_outputs;
  const int tile = (rows + 2) * (columns + 2), taps = channels * slices * 9;
  for (int o_begin = 0; o_begin < out_channels; o_begin += outputs) {
    __syncthreads();
    for (int i = threadIdx.x; i < taps * outputs; i += threads_per_block) {
      const int o = o_begin + i % outputs;
      staged[i] = o < out_channels ? read(weight + static_cast<int64_t>(o) * taps + i / outputs) : T(0);
    }
    __syncthreads();
    for (int i = threadIdx.x; i < depth * rows * columns; i += threads_per_block) {
      const int x = i % columns, y = i / columns % rows, z = i / columns / rows;
      T sums[outputs];
#pragma unroll
      for (int o = 0; o < outputs; ++o) {
        sums[o] = bias != nullptr && o_begin + o < out_channels ? read(bias + o_begin + o) : T(0);
      }
      for (int p = 0; p < channels * slices; ++p) {
        const int from = z + p % slices - slices / 2;
        if (from < 0 || from >= depth) continue;
        const T* window = input + (p / slices * depth + from) * tile + y * (columns + 2) + x;
        add_taps(window, columns + 2, staged + p * 9 * outputs, sums);
      }
      write(o_begin, z, y, x, sums);
    }
  }
}

template <class T>
__global__ void __launch_bounds__(threads_per_block, 4) pair(ConvPair<T> a, int64_t x_tiles, int64_t y_tiles) {
  const ConvShape& s = a.shape;
  const int64_t x_begin = blockIdx.x % x_tiles * pair_columns, y_begin = blockIdx.x / x_tiles % y_tiles * pair_rows;
  const int64_t n = blockIdx.x / x_tiles / y_tiles;
  const int channels = static_cast<int>(s.in_channels), middles = static_cast<int>(s.out_channels);
  const int outputs = static_cast<int>(a.out_channels), most = channels > middles ? channels : middles;
  const int depth = static_cast<int>(s.depth), slices = static_cast<int>(s.kernel_depth);
  constexpr int rows = pair_rows + 4, columns = pair_columns + 4;
  constexpr int middle_rows = pair_rows + 2, middle_columns = pair_columns + 2;

  SharedMemory shared;
  T* const input = shared.take<T>(channels * depth * rows * columns);
  T* const middle = shared.take<T>(middles * depth * middle_rows * middle_columns);
  T* const staged = shared.take<T>(most * slices * 9 * pair_outputs);
  for (int i = threadIdx.x; i < rows * columns; i += threads_per_block) {
    const int64_t y = y_begin + i / columns - 2, x = x_begin + i % columns - 2;
    const bool inside = y >= 0 && y < s.height && x >= 0 && x < s.width;
    const T* from = a.input + (n * channels * depth * s.height + y) * s.width + x;
    for (int p = 0; p < channels * depth; ++p) {
      input[p * rows * columns + i] = inside ? read(from + p * s.height * s.width) : T(0);
    }
  }
  convolve(input, channels, depth, middle_rows, middle_columns, slices, a.weight_first, a.bias_first, middles, staged,
           [&](int o_begin, int z, int row, int column, const T(&sums)[pair_outputs]) {
             const int64_t y = y_begin + row - 1, x = x_begin + column - 1;
             const bool inside = y >= 0 && y < s.height && x >= 0 && x < s.width;
#pragma unroll
             for (int o = 0; o < pair_outputs; ++o) {
               if (o_begin + o < middles) {
                 const int slice = (o_begin + o) * depth + z;
                 middle[(slice * middle_rows + row) * middle_columns + column] = inside ? relu(sums[o]) : T(0);
               }
             }
           });
  convolve(middle, middles, depth, pair_rows, pair_columns, slices, a.weight_second, a.bias_second, outputs, staged,
           [&](int o_begin, int z, int row, int column, const T(&sums)[pair_outputs]) {
             const int64_t y = y_begin + row, x = x_begin + column;
             if (y >= s.height || x >= s.width) return;
#pragma unroll
             for (int o = 0; o < pair_outputs; ++o) {
               if (o_begin + o < outputs) {
                 const int64_t slice = (n * outputs + o_begin + o) * depth + z;
                 a.out[(slice * s.height + y) * s.width + x] = a.relu_out ? relu(sums[o]) : sums[o];
               }
             }
           });
}

int64_t pair_bytes(const ConvShape& s) {
  const int64_t most = s.in_channels > s.out_channels ? s.in_channels : s.out_channels;
  return shared_bytes<float>(s.in_channels * s.depth * (pair_rows + 4) * (pair_columns + 4)) +
         shared_bytes<float>(s.out_channels * s.depth * (pair_rows + 2) * (pair_columns + 2)) +
         shared_bytes<float>(most * s.kernel_depth * 9 * pair_outputs);
}

}  // namespace

bool conv_pair_fits(const ConvShape& first) { return first.depth <= 64 && pair_bytes(first) <= pair_shared; }

void conv_pair(const ConvPair<float>& a, Stream stream) {
  const int64_t x_tiles = ceil_div(a.shape.width, pair_columns), y_tiles = ceil_div(a.shape.height, pair_rows);
  launch("conv_pair", pair<float>, a.shape.batch * y_tiles * x_tiles, threads_per_block, pair_bytes(a.shape), stream, a,
         x_tiles, y_tiles);
}

template <class T>
void conv(const Conv<T>& a, Stream stream) {
  const int64_t outputs = a.shape.out_channels;
  (outputs == 1 ? run<T, 1> : outputs <= 4 ? run<T, 4> : run<T, 8>)(a, stream);
}

template void conv<float>(const Conv<float>&, Stream);
template void conv<double>(const Conv<double>&, Stream);

}  // namespace anynet::cuda
