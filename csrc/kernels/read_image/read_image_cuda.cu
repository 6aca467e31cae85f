// One thread per pixel of the downsampled image: it reads the middle 2x2 of its factor x factor, and writes three
// planes.
#include "../common/cuda.h"
#include "cuda_reader.h"
#include "read_image.h"

namespace anynet::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) read_pixels(ReadImage<T> a) {
  const int64_t block = a.block, width = block * a.width;
  const Pixel at(width);
  if (at.row >= block * a.height || at.x >= width) return;
  T pixel[3];
  Reader<T>{a.image, a.image_height, a.image_width, a.factor, a.mean, a.std}(at.row, at.x, pixel);
  const int64_t plane = a.height * a.width, channels = block * block;
  T* out = a.out + (at.row % block * block + at.x % block) * plane + at.row / block * a.width + at.x / block;
#pragma unroll
  for (int c = 0; c < 3; ++c) out[c * channels * plane] = pixel[c];
}

}  // namespace

template <class T>
void read_image(const ReadImage<T>& a, Stream stream) {
  launch("read_image", read_pixels<T>, Pixel::blocks(a.block * a.height, a.block * a.width), Pixel::threads(), 0,
         stream, a);
}

template void read_image<float>(const ReadImage<float>&, Stream);

}  // namespace anynet::cuda
