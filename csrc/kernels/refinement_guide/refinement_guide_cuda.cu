// One thread per pixel of the disparity: it reads what it sees of the left image, and two pixels of the right one.
#include "../common/cuda.h"
#include "../common/cuda_sampling.h"
#include "../read_image/cuda_reader.h"
#include "refinement_guide.h"

namespace anynet::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) guide(RefinementGuide<T> a) {
  const Pixel here(a.width);
  if (here.row >= a.height || here.x >= a.width) return;
  const int64_t plane = a.height * a.width, pixel = here.row * a.width + here.x, shown = a.block * a.block;
  const int width = static_cast<int>(a.width);
  const T disparity = read(a.disparity + pixel) / static_cast<T>(a.factor);
  const Position<T> at = locate(static_cast<int>(here.x), disparity, 0, -2, width);
  const auto reader = [&](int side, int64_t factor) {
    return Reader<T>{a.image[side], a.image_height, a.image_width, factor, a.mean, a.std};
  };
  T* out = a.out + pixel;
  for (int64_t i = 0; i < shown; ++i) {
    T seen[3];
    reader(0, a.factor / a.block)(a.block * here.row + i / a.block, a.block * here.x + i % a.block, seen);
#pragma unroll
    for (int c = 0; c < 3; ++c) out[(c * shown + i) * plane] = seen[c];
  }
  T left[3], near[3] = {}, next[3] = {};
  reader(0, a.factor)(here.row, here.x, left);
  const Reader<T> right = reader(1, a.factor);
  if (at.index >= 0 && at.index < width) right(here.row, at.index, near);
  if (at.index + 1 >= 0 && at.index + 1 < width) right(here.row, at.index + 1, next);
  out += 3 * shown * plane;
#pragma unroll
  for (int c = 0; c < 3; ++c) out[c * plane] = sample(at, near[c], next[c]) - left[c];
  out[3 * plane] = disparity;
}

}  // namespace

template <class T>
void refinement_guide(const RefinementGuide<T>& a, Stream stream) {
  launch("refinement_guide", guide<T>, Pixel::blocks(a.height, a.width), Pixel::threads(), 0, stream, a);
}

template void refinement_guide<float>(const RefinementGuide<float>&, Stream);

}  // namespace anynet::cuda
