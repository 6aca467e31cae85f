// The rows of read_image.h. Included by files that are compiled per instruction set.
#pragma once

#include <algorithm>

#include "../common/rgb.h"
#include "read_image.h"

namespace anynet::ANYNET_ISA {

/// What an image gives, row by row.
template <class T>
class Reader {
 public:
  explicit Reader(const ReadImage<T>& a) : a_(a) {}

  /// Row y of the planes [3,block,block], each of `width` pixels and `plane` from the one before.
  void row(int64_t y, T* out, int64_t plane) const {
    for (int64_t i = 0; i < a_.block; ++i) {
      const int64_t source = a_.factor * (a_.block * y + i);
      const uint8_t *upper = line(source + first()), *lower = line(source + second());
      T* to = out + i * a_.block * plane;
      if (a_.factor == 4 && a_.block == 1) {
        by_four<4, 1>(upper, lower, to, plane);
      } else if (a_.factor == 2 && a_.block == 2) {
        by_four<2, 2>(upper, lower, to, plane);
      } else {
        one_by_one(upper, lower, to, plane);
      }
    }
  }

 private:
  // The rows and columns of a factor x factor that count.
  int64_t first() const { return std::max<int64_t>(a_.factor / 2 - 1, 0); }
  int64_t second() const { return a_.factor / 2; }
  const uint8_t* line(int64_t y) const { return a_.image + std::min(y, a_.image_height - 1) * a_.image_width * 3; }
  T gain(int c) const { return T(0.25) / a_.std[c]; }

  /// Where four pixels of the image go into each pixel of a plane.
  template <int factor, int block>
  void by_four(const uint8_t* upper, const uint8_t* lower, T* out, int64_t plane) const {
    static_assert(factor * block == 4);
    for (int64_t x = 0; x < a_.width; x += lanes<T>) {
      const FourPixels above(upper, a_.image_width, x), below(lower, a_.image_width, x);
      const int64_t count = std::min<int64_t>(a_.width - x, lanes<T>);
#pragma GCC unroll 2
      for (int j = 0; j < block; ++j) {
#pragma GCC unroll 3
        for (int c = 0; c < 3; ++c) {
          const int left = 3 * (factor * j + factor / 2 - 1) + c, right = left + 3;
          const auto sum = above[left] + above[right] + below[left] + below[right];
          const vec<T> value = (__builtin_convertvector(sum, vec<T>) - 4 * a_.mean[c]) * gain(c);
          write_vector<T>(value, count, out + (c * block * block + j) * plane + x);
        }
      }
    }
  }

  void one_by_one(const uint8_t* upper, const uint8_t* lower, T* out, int64_t plane) const {
    const auto column = [&](int64_t x) { return 3 * std::min(x, a_.image_width - 1); };
    for (int64_t j = 0; j < a_.block; ++j) {
      for (int64_t x = 0; x < a_.width; ++x) {
        const int64_t from = a_.factor * (a_.block * x + j);
        const int64_t left = column(from + first()), right = column(from + second());
        for (int c = 0; c < 3; ++c) {
          const int32_t sum = upper[left + c] + upper[right + c] + lower[left + c] + lower[right + c];
          out[(c * a_.block * a_.block + j) * plane + x] = (static_cast<T>(sum) - 4 * a_.mean[c]) * gain(c);
        }
      }
    }
  }

  const ReadImage<T> a_;
};

}  // namespace anynet::ANYNET_ISA
