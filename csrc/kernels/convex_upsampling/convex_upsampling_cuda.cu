// One thread per pixel of the input, which becomes four: rows are written in pairs of pixels.
#include <cmath>

#include "../common/cuda.h"
#include "convex_upsampling.h"

namespace anynet::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) upsample(ConvexUpsampling<T> a) {
  const Pixel at(a.width);
  if (at.row >= a.batch * a.height || at.x >= a.width) return;
  const int64_t n = at.row / a.height, y = at.row % a.height, plane = a.height * a.width;
  T around[9];
#pragma unroll
  for (int i = 0; i < 9; ++i) {
    const int64_t row = y + i / 3 - 1, column = at.x + i % 3 - 1;
    around[i] = read(a.in + n * plane +
                     (row < 0          ? 0
                      : row < a.height ? row
                                       : a.height - 1) *
                         a.width +
                     (column < 0         ? 0
                      : column < a.width ? column
                                         : a.width - 1));
  }
  const T* logits = a.logits + n * 32 * plane + y * a.width + at.x;
#pragma unroll
  for (int i = 0; i < 2; ++i) {
    Pack<T, 2> pair;
#pragma unroll
    for (int j = 0; j < 2; ++j) {
      T logit[8], most = 0;
#pragma unroll
      for (int k = 0; k < 8; ++k) {
        logit[k] = read(logits + ((2 * i + j) * 8 + k) * plane);
        most = most < logit[k] ? logit[k] : most;
      }
      T sum = exp(-most), value = sum * around[4];
#pragma unroll
      for (int k = 0; k < 8; ++k) {
        const T weight = exp(logit[k] - most);
        sum += weight;
        value += weight * around[k < 4 ? k : k + 1];
      }
      pair.value[j] = value / sum;
    }
    write_pack(a.out + ((2 * at.row + i) * a.width + at.x) * 2, pair);
  }
}

}  // namespace

template <class T>
void convex_upsampling(const ConvexUpsampling<T>& a, Stream stream) {
  launch("convex_upsampling", upsample<T>, Pixel::blocks(a.batch * a.height, a.width), Pixel::threads(), 0, stream, a);
}

template void convex_upsampling<float>(const ConvexUpsampling<float>&, Stream);

}  // namespace anynet::cuda
