// One thread per pixel of the result.
#include "../common/cuda.h"
#include "max_pool.h"

namespace anynet::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) pool(MaxPool<T> a) {
  const int64_t height = a.height / 2, width = a.width / 2;
  const Pixel at(width);
  if (at.row >= a.batch * a.channels * height || at.x >= width) return;
  const int64_t plane = at.row / height, y = at.row % height;
  const T* upper = a.in + (plane * a.height + 2 * y) * a.width + 2 * at.x;
  const T* lower = upper + a.width;
  const auto larger = [](T p, T q) { return p < q || q != q ? q : p; };  // keeps NaN
  const T largest = larger(larger(read(upper), read(upper + 1)), larger(read(lower), read(lower + 1)));
  a.out[at.row * width + at.x] = apply(a.epilogue, plane, largest);
}

}  // namespace

template <class T>
void max_pool(const MaxPool<T>& a, Stream stream) {
  launch("max_pool", pool<T>, Pixel::blocks(a.batch * a.channels * (a.height / 2), a.width / 2), Pixel::threads(), 0,
         stream, a);
}

template void max_pool<float>(const MaxPool<float>&, Stream);

}  // namespace anynet::cuda
