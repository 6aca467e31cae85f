#include "../common/parallel.h"
#include "max_pool.h"

namespace anynet::ANYNET_ISA {

template <class T>
void max_pool(const MaxPool<T>& a, int threads) {
  const int64_t height = a.height / 2, width = a.width / 2;
  threads = useful_threads(threads, a.batch, a.channels, height, width, 4);
  parallel_for(a.batch * a.channels * height, threads, [&](int64_t i) {
    const int64_t plane = i / height, y = i % height;
    const T* upper = a.in + (plane * a.height + 2 * y) * a.width;
    const T* lower = upper + a.width;
    const T scale = a.epilogue.scale[plane % a.channels], shift = a.epilogue.shift[plane % a.channels];
    T* __restrict out = a.out + i * width;
    const auto larger = [](T p, T q) {  // keeps NaN, by two selections, which GCC makes vectors of
      const T most = p < q ? q : p;
      return q != q ? q : most;
    };
    for (int64_t x = 0; x < width; ++x) {
      const T largest = larger(larger(upper[2 * x], upper[2 * x + 1]), larger(lower[2 * x], lower[2 * x + 1]));
      out[x] = larger(scale * largest + shift, T(0));
    }
  });
}

template void max_pool<float>(const MaxPool<float>&, int);

}  // namespace anynet::ANYNET_ISA
