// Rows of 8-bit RGB images, in vectors. Included by files that are compiled per instruction set.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <utility>

#include "simd.h"

namespace anynet::ANYNET_ISA {

typedef uint32_t words __attribute__((vector_size(vector_bytes)));

/// Elements first, first + 3, first + 6, ... of three vectors.
template <int first, int... I>
ANYNET_INLINE words deinterleave_by_3(const words (&v)[3], std::integer_sequence<int, I...>) {
  constexpr int n = sizeof...(I);
  const words two = shuffle<(3 * I + first < 2 * n ? 3 * I + first : 0)...>(v[0], v[1]);
  return shuffle<(3 * I + first < 2 * n ? I : 3 * I + first - n)...>(two, v[2]);
}

/// Four pixels of a row per lane: the columns 4 j, 4 (j + 1), ... and three after each. Beyond the row, its last pixel.
class FourPixels {
 public:
  ANYNET_INLINE FourPixels(const uint8_t* row, int64_t width, int64_t j) {
    constexpr int64_t size = 3 * vector_bytes;
    const int64_t begin = 12 * j, end = 3 * width, inside = std::clamp<int64_t>(end - begin, 0, size);
    const uint8_t* from = row + begin;
    uint8_t bytes[size];
    if (inside < size) {
      std::memcpy(bytes, from, inside);
      for (int64_t i = inside; i < size; ++i) bytes[i] = row[end - 3 + i % 3];
      from = bytes;
    }
    words read[3];
    for (int i = 0; i < 3; ++i) std::memcpy(read + i, from + i * vector_bytes, vector_bytes);
    constexpr auto sequence = std::make_integer_sequence<int, lanes<float>>{};
    words_[0] = deinterleave_by_3<0>(read, sequence);
    words_[1] = deinterleave_by_3<1>(read, sequence);
    words_[2] = deinterleave_by_3<2>(read, sequence);
  }

  /// Byte i of each twelve: channel i % 3 of pixel i / 3. For loops that are unrolled.
  ANYNET_INLINE Simd<float>::mask operator[](int i) const {
    return reinterpret_cast<Simd<float>::mask>(words_[i / 4] >> (8 * (i % 4)) & 255);
  }

 private:
  words words_[3];
};

}  // namespace anynet::ANYNET_ISA
