// One thread per pixel of the downsampled image: it reads the middle 2x2 of its factor x factor, and writes three
// planes.
#include "../common/cuda.h"
#include "read_image.h"

namespace anynet::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) read_pixels(ReadImage<T> a) {
  const int64_t block = a.block, width = block * a.width;
  const Pixel at(width);
  if (at.row >= block * a.height || at.x >= width) return;
  const int64_t first = a.factor > 2 ? 1 : 0, second = a.factor / 2;
  const auto line = [&](int64_t y) {
    return a.image + (y < a.image_height ? y : a.image_height - 1) * a.image_width * 3;
  };
  const auto column = [&](int64_t x) { return 3 * (x < a.image_width ? x : a.image_width - 1); };
  const uint8_t *upper = line(a.factor * at.row + first), *lower = line(a.factor * at.row + second);
  const int64_t left = column(a.factor * at.x + first), right = column(a.factor * at.x + second);
  const int64_t plane = a.height * a.width, channels = block * block;
  T* out = a.out + (at.row % block * block + at.x % block) * plane + at.row / block * a.width + at.x / block;
#pragma unroll
  for (int c = 0; c < 3; ++c) {
    const int sum =
        __ldg(upper + left + c) + __ldg(upper + right + c) + __ldg(lower + left + c) + __ldg(lower + right + c);
    out[c * channels * plane] = (static_cast<T>(sum) / 4 - read(a.mean + c)) / read(a.std + c);
  }
}

}  // namespace

template <class T>
void read_image(const ReadImage<T>& a, Stream stream) {
  launch("read_image", read_pixels<T>, Pixel::blocks(a.block * a.height, a.block * a.width), Pixel::threads(), 0,
         stream, a);
}

template void read_image<float>(const ReadImage<float>&, Stream);

}  // namespace anynet::cuda
