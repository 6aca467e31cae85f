// One thread per pixel of the result; what neighbors read twice comes from the cache.
#include "../common/cuda.h"
#include "upsample.h"

namespace anynet::cuda {
namespace {

/// The map [height, width] smoothed at a pixel: `side` of its neighbors along both axes, the border going on.
template <class T>
ANYNET_DEVICE T smoothed(const T* map, int64_t height, int64_t width, int64_t y, int64_t x, T side) {
  T sum = 0;
#pragma unroll
  for (int i = -1; i <= 1; ++i) {
    const int64_t row = y + i < 0 ? 0 : y + i < height ? y + i : height - 1;
    const T* line = map + row * width;
    const T across = (1 - 2 * side) * read(line + x) +
                     side * (read(line + (x > 0 ? x - 1 : 0)) + read(line + (x + 1 < width ? x + 1 : width - 1)));
    sum += (i == 0 ? 1 - 2 * side : side) * across;
  }
  return sum;
}

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) sum_maps(UpsampleSum<T> a) {
  const Pixel at(a.out_width);
  if (at.row >= a.out_height || at.x >= a.out_width) return;
  T sum = 0;
  for (int i = 0; i < a.count; ++i) {
    const float ratio = static_cast<float>(a.ratio[i]);
    sum += a.gain[i] * (i == a.count - 1 && a.side > 0
                            ? smoothed(a.map[i], a.height[i], a.width[i], at.row, at.x, a.side)
                            : bilinear(a.map[i], a.width[i], LinearPosition::half_pixel(at.row, ratio, a.height[i]),
                                       LinearPosition::half_pixel(at.x, ratio, a.width[i])));
  }
  a.out[at.row * a.out_width + at.x] = sum;
}

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) concat(UpsampleConcat<T> a) {
  const Pixel at(a.width);
  const int64_t channels = a.skip_channels + a.coarse_channels, plane = at.row / a.height, y = at.row % a.height;
  if (plane >= a.batch * channels || at.x >= a.width) return;
  const int64_t n = plane / channels, c = plane % channels;
  T value;
  if (c < a.skip_channels) {
    value = read(a.skip + ((n * a.skip_channels + c) * a.height + y) * a.width + at.x);
  } else {
    const T* coarse = a.coarse + (n * a.coarse_channels + c - a.skip_channels) * a.coarse_height * a.coarse_width;
    value = bilinear(coarse, a.coarse_width, LinearPosition::corners(y, a.height, a.coarse_height),
                     LinearPosition::corners(at.x, a.width, a.coarse_width));
  }
  a.out[at.row * a.width + at.x] = apply(a.epilogue, plane, value);
}

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) add(UpsampleAdd<T> a) {
  const Pixel at(a.width);
  const int64_t volume = at.row / a.height / a.depth;
  if (volume >= a.batch * a.channels || at.x >= a.width) return;
  const auto position = [](int64_t i, int64_t size, int64_t coarse) {
    return LinearPosition::half_pixel(i, static_cast<float>(size) / static_cast<float>(coarse), coarse);
  };
  const LinearPosition z = position(at.row / a.height % a.depth, a.depth, a.coarse_depth);
  const LinearPosition y = position(at.row % a.height, a.height, a.coarse_height);
  const LinearPosition x = position(at.x, a.width, a.coarse_width);
  const int64_t plane = a.coarse_height * a.coarse_width;
  const T* coarse = a.coarse + volume * a.coarse_depth * plane;
  const T value = z.between(bilinear(coarse + z.low * plane, a.coarse_width, y, x),
                            bilinear(coarse + z.high * plane, a.coarse_width, y, x));
  const int64_t i = at.row * a.width + at.x;
  a.out[i] = apply(a.epilogue, volume, read(a.input + i) + value);
}

}  // namespace

template <class T>
void upsample_sum(const UpsampleSum<T>& a, Stream stream) {
  launch("upsample_sum", sum_maps<T>, Pixel::blocks(a.out_height, a.out_width), Pixel::threads(), 0, stream, a);
}

template <class T>
void upsample_concat(const UpsampleConcat<T>& a, Stream stream) {
  const int64_t planes = a.batch * (a.skip_channels + a.coarse_channels);
  launch("upsample_concat", concat<T>, Pixel::blocks(planes * a.height, a.width), Pixel::threads(), 0, stream, a);
}

template <class T>
void upsample_add(const UpsampleAdd<T>& a, Stream stream) {
  launch("upsample_add", add<T>, Pixel::blocks(a.batch * a.channels * a.depth * a.height, a.width), Pixel::threads(), 0,
         stream, a);
}

template void upsample_sum<float>(const UpsampleSum<float>&, Stream);
template void upsample_concat<float>(const UpsampleConcat<float>&, Stream);
template void upsample_add<float>(const UpsampleAdd<float>&, Stream);

}  // namespace anynet::cuda
