// Rows sampled linearly at regular positions. Included by files that are compiled per instruction set.
#pragma once

#include <algorithm>
#include <cstdint>

#include "scratch.h"
#include "simd.h"

namespace anynet::ANYNET_ISA {
namespace {

/// A position on an axis of `size` elements: between `low` and `low + 1`, at `fraction`, clamped to the axis. An axis
/// of one element is read as two equal ones.
template <class T>
struct LinearPosition {
  int64_t low;
  T fraction;

  LinearPosition(T p, int64_t size) : low(static_cast<int64_t>(std::max(p, T(0)))) {
    low = std::min(low, std::max<int64_t>(size - 2, 0));
    fraction = std::min(std::max(p - static_cast<T>(low), T(0)), T(1));
  }
};

/// Of element i of an axis that is `ratio` times longer, align_corners=False.
template <class T>
LinearPosition<T> half_pixel_position(int64_t i, T ratio, int64_t size) {
  return {(static_cast<T>(i) + T(0.5)) / ratio - T(0.5), size};
}

/// Of element i of an axis of `out_size`, align_corners=True.
template <class T>
LinearPosition<T> corner_position(int64_t i, int64_t out_size, int64_t size) {
  return {out_size > 1 ? static_cast<T>(i * (size - 1)) / static_cast<T>(out_size - 1) : T(0), size};
}

/// Interpolates between two rows of a map; `padding` more elements replicate the last one.
template <class T>
void interpolate_rows(const T* map, int64_t width, int64_t height, const LinearPosition<T>& y, int64_t padding,
                      T* __restrict line) {
  const T* upper = map + y.low * width;
  const T* lower = y.low + 1 < height ? upper + width : upper;
  for (int64_t x = 0; x < width; ++x) line[x] = upper[x] + y.fraction * (lower[x] - upper[x]);
  for (int64_t x = width; x < width + padding; ++x) line[x] = line[width - 1];
}

/// Resamples rows of `width` elements at the same `out_width` positions each.
template <class T>
class RowInterpolator {
 public:
  template <class F>
  RowInterpolator(int64_t out_width, int64_t width, const F& position)
      : out_width_(out_width), width_(width), low_(out_width), fraction_(out_width), line_(width + 1) {
    for (int64_t x = 0; x < out_width; ++x) {
      const LinearPosition<T> p = position(x);
      low_[x] = static_cast<int32_t>(p.low);
      fraction_[x] = p.fraction;
    }
  }

  /// write(x, value) for each column x of the row at `y` of `map`.
  template <class F>
  void row(const T* map, int64_t height, const LinearPosition<T>& y, const F& write) {
    interpolate_rows<T>(map, width_, height, y, 1, line_);
    row(line_, write);
  }

  /// The same for a row that is there, its last element replicated once.
  template <class F>
  void row(const T* __restrict line, const F& write) {
    const int32_t* __restrict low = low_;
    const T* __restrict fraction = fraction_;
#pragma omp simd
    for (int64_t x = 0; x < out_width_; ++x) {
      const T left = line[low[x]];
      write(x, left + fraction[x] * (line[low[x] + 1] - left));
    }
  }

 private:
  int64_t out_width_, width_;
  Scratch<int32_t> low_;
  Scratch<T> fraction_, line_;
};

}  // namespace
}  // namespace anynet::ANYNET_ISA
