#include "upsample_sum.h"

#include <algorithm>

#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"

namespace anynet::ANYNET_ISA {
namespace {

/// Position `i` of an axis enlarged `ratio` times, among `size` elements: between `low` and `low + 1`, at `fraction`.
template <class T>
struct Position {
  int64_t low;
  T fraction;
  Position(int64_t i, int64_t ratio, int64_t size) {
    const T p = (static_cast<T>(i) + T(0.5)) / static_cast<T>(ratio) - T(0.5);
    low = p < 0 ? 0 : static_cast<int64_t>(p);
    fraction = p < 0 ? 0 : p - static_cast<T>(low);
    if (low > size - 2) low = size - 2, fraction = 1;  // and a row of one element counts as two equal ones
  }
};

}  // namespace

template <class T>
void upsample_sum(const UpsampleSum<T>& a, int threads) {
  parallel_ranges(a.out_height, threads, [&](int64_t begin, int64_t end) {
    int64_t widest = 2;
    for (int i = 0; i < a.count; ++i) widest = std::max(widest, a.width[i]);
    Scratch<int32_t> lows(a.count * a.out_width);
    Scratch<T> fractions(a.count * a.out_width), line(widest);
    for (int i = 0; i < a.count; ++i) {
      for (int64_t x = 0; x < a.out_width; ++x) {
        const Position<T> p(x, a.ratio[i], std::max<int64_t>(a.width[i], 2));
        lows[i * a.out_width + x] = static_cast<int32_t>(p.low);
        fractions[i * a.out_width + x] = p.fraction;
      }
    }
    for (int64_t y = begin; y < end; ++y) {
      T* __restrict out = a.out + y * a.out_width;
      for (int i = 0; i < a.count; ++i) {
        const int64_t width = a.width[i];
        const Position<T> p(y, a.ratio[i], std::max<int64_t>(a.height[i], 2));
        const T* upper = a.map[i] + p.low * width;
        const T* lower = a.height[i] > 1 ? upper + width : upper;
        T* __restrict row = line;
        for (int64_t x = 0; x < width; ++x) row[x] = a.gain * (upper[x] + p.fraction * (lower[x] - upper[x]));
        if (width == 1) row[1] = row[0];
        const int32_t* __restrict low = lows + i * a.out_width;
        const T* __restrict fraction = fractions + i * a.out_width;
        for (int64_t x = 0; x < a.out_width; ++x) {
          const T left = row[low[x]], value = left + fraction[x] * (row[low[x] + 1] - left);
          out[x] = i == 0 ? value : out[x] + value;
        }
      }
    }
  });
}

template void upsample_sum<float>(const UpsampleSum<float>&, int);

}  // namespace anynet::ANYNET_ISA
