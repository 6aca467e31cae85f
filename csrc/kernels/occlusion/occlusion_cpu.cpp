#include <algorithm>
#include <limits>

#include "../common/parallel.h"
#include "../common/scratch.h"
#include "occlusion.h"

namespace anynet::ANYNET_ISA {

template <class T>
void fill_occlusions(const FillOcclusions<T>& a, int threads) {
  const auto clamp = [](T x) { return std::min(std::max(x, T(0)), T(1)); };
  const auto blend = [](T own, T neighbor, T gate) { return (T(1) - gate) * own + gate * neighbor; };
  parallel_ranges(a.rows, useful_threads(threads, a.rows, a.width, 8), [&](int64_t begin, int64_t end) {
    const Scratch<T> occluded(a.width);
    for (int64_t y = begin; y < end; ++y) {
      const T* disparity = a.disparity + y * a.width;
      T* out = a.out + y * a.width;
      T leftmost = std::numeric_limits<T>::infinity(), neighbor = disparity[a.width - 1];
      for (int64_t x = a.width - 1; x >= 0; --x) {
        const T p = static_cast<T>(x) - disparity[x] / a.pixel;
        leftmost = std::min(leftmost, p);
        const T out_of_view = clamp(T(-0.5) * p);
        occluded[x] = clamp(T(0.5) * (p - leftmost - T(0.5))) * (T(1) - out_of_view);
        out[x] = neighbor = blend(disparity[x], neighbor, out_of_view);
      }
      for (int64_t x = 1; x < a.width; ++x) out[x] = neighbor = blend(out[x], neighbor, occluded[x]);
    }
  });
}

template void fill_occlusions<float>(const FillOcclusions<float>&, int);

}  // namespace anynet::ANYNET_ISA
