// A block has 16 x 4 pixels of the result: what they see of the image, 67 x 19, lies in shared memory, and of the first
// layer one channel at a time, 65 x 17, from which each thread adds to the four pixels of the second layer that it
// pools.
#include "../common/cuda.h"
#include "stem.h"

namespace anynet::cuda {
namespace {

constexpr int tile_columns = 16, tile_rows = 4, threads_per_block = tile_columns * tile_rows;
constexpr int first_columns = 4 * tile_columns + 1, first_rows = 4 * tile_rows + 1;
constexpr int image_columns = first_columns + 2, image_rows = first_rows + 2;
constexpr int outputs = 4;  // channels of the second layer at a time

/// The upsampled image, padded by replication, less the mean; 0 outside.
template <class T>
ANYNET_DEVICE T image_pixel(const Stem<T>& a, const uint8_t* image, int64_t y, int64_t x, int c) {
  if (y < 0 || y >= a.height || x < 0 || x >= a.width) return 0;
  const int64_t height = a.input_scale * a.image_height, width = a.input_scale * a.image_width;
  y = y < height ? y : height - 1;
  x = x < width ? x : width - 1;
  const auto value = [&](int64_t row, int64_t column) {
    return static_cast<T>(__ldg(image + (row * a.image_width + column) * 3 + c));
  };
  const T mean = read(a.mean + c);
  if (a.input_scale == 1) return value(y, x) - mean;
  const LinearPosition row = LinearPosition::half_pixel(y, 2, a.image_height);
  const LinearPosition column = LinearPosition::half_pixel(x, 2, a.image_width);
  return column.between(row.between(value(row.low, column.low), value(row.high, column.low)),
                        row.between(value(row.low, column.high), value(row.high, column.high))) -
         mean;
}

template <class T>
__global__ void __launch_bounds__(threads_per_block) both_layers(Stem<T> a, int64_t x_tiles, int64_t y_tiles) {
  int64_t block = blockIdx.x;
  const int64_t x_begin = block % x_tiles * tile_columns;
  block /= x_tiles;
  const int64_t y_begin = block % y_tiles * tile_rows;
  block /= y_tiles;
  const int64_t chunks = (a.channels + outputs - 1) / outputs, o_begin = block % chunks * outputs;
  const int side = static_cast<int>(block / chunks);
  const int column = threadIdx.x, row = threadIdx.y, thread = row * tile_columns + column;

  const uint8_t* const bytes = side == 0 ? a.image[0] : a.image[1];  // an index would put the arguments into memory

  SharedMemory shared;
  T* const image = shared.take<T>(3 * image_rows * image_columns);
  T* const first = shared.take<T>(first_rows * first_columns);
  for (int i = thread; i < image_rows * image_columns; i += threads_per_block) {
    const int64_t y = 4 * y_begin + i / image_columns - 2, x = 4 * x_begin + i % image_columns - 2;
#pragma unroll
    for (int c = 0; c < 3; ++c) image[c * image_rows * image_columns + i] = image_pixel(a, bytes, y, x, c);
  }
  T sums[outputs][4] = {};
  for (int64_t c = 0; c < a.channels; ++c) {
    __syncthreads();
    for (int i = thread; i < first_rows * first_columns; i += threads_per_block) {
      const int r = i / first_columns, q = i % first_columns;
      const int64_t y = 4 * y_begin + r - 1, x = 4 * x_begin + q - 1;
      T sum = 0;
      if (y >= 0 && y < a.height && x >= 0 && x < a.width) {
        sum = read(a.bias_first + c);
        const T* weight = a.weight_first + c * 27;
#pragma unroll
        for (int t = 0; t < 27; ++t) {
          sum += read(weight + t) * image[(t / 9 * image_rows + r + t % 9 / 3) * image_columns + q + t % 3];
        }
        sum = relu(sum);
      }
      first[i] = sum;
    }
    __syncthreads();
    T window[25];
#pragma unroll
    for (int t = 0; t < 25; ++t) window[t] = first[(4 * row + t / 5) * first_columns + 4 * column + t % 5];
#pragma unroll
    for (int o = 0; o < outputs; ++o) {
      if (o_begin + o < a.channels) {
        const T* weight = a.weight_second + ((o_begin + o) * a.channels + c) * 9;
#pragma unroll
        for (int t = 0; t < 9; ++t) {
          const T w = read(weight + t);
#pragma unroll
          for (int i = 0; i < 4; ++i) sums[o][i] += w * window[(i / 2 * 2 + t / 3) * 5 + i % 2 * 2 + t % 3];
        }
      }
    }
  }
  const int64_t height = a.height / 4, width = a.width / 4, y = y_begin + row, x = x_begin + column;
  if (y >= height || x >= width) return;
  const auto larger = [](T p, T q) { return p < q || q != q ? q : p; };  // keeps NaN
#pragma unroll
  for (int o = 0; o < outputs; ++o) {
    const T largest = larger(larger(sums[o][0], sums[o][1]), larger(sums[o][2], sums[o][3]));
    const int64_t c = o_begin + o;
    if (c < a.channels) {
      const T value = read(a.epilogue.scale + c) * largest + read(a.epilogue.shift + c);
      a.out[((side * a.channels + c) * height + y) * width + x] = relu(value);
    }
  }
}

}  // namespace

template <class T>
void stem(const Stem<T>& a, Stream stream) {
  const int64_t x_tiles = ceil_div(a.width / 4, tile_columns), y_tiles = ceil_div(a.height / 4, tile_rows);
  launch("stem", both_layers<T>, 2 * ceil_div(a.channels, outputs) * y_tiles * x_tiles, dim3(tile_columns, tile_rows),
         shared_bytes<T>(3 * image_rows * image_columns) + shared_bytes<T>(first_rows * first_columns), stream, a,
         x_tiles, y_tiles);
}

template void stem<float>(const Stem<float>&, Stream);

}  // namespace anynet::cuda
