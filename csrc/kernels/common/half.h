// Half types to and from float, on their bits: not every compiler has a type for them (GCC 11 and Clang 14 none on
// x86-64, GCC 12 none on aarch64), and branch-free integer arithmetic is what they all turn into vectors.
#pragma once

#include <cstring>

#include "tensor.h"

// Of internal linkage, so that what is compiled for one instruction set stays there.
#define ANYNET_STATIC_INLINE static inline __attribute__((always_inline))

namespace anynet {

ANYNET_STATIC_INLINE uint32_t bits_of(float a) {
  uint32_t bits;
  std::memcpy(&bits, &a, sizeof(bits));
  return bits;
}
ANYNET_STATIC_INLINE float float_of(uint32_t bits) {
  float a;
  std::memcpy(&a, &bits, sizeof(a));
  return a;
}

ANYNET_STATIC_INLINE float to_float(float16 h) {
  const uint32_t sign = static_cast<uint32_t>(h.bits & 0x8000) << 16, magnitude = h.bits & 0x7fff;
  const uint32_t rebias = (127 - 15) << 23;
  const uint32_t normal = (magnitude << 13) + rebias + (magnitude >= 0x7c00 ? rebias : 0);  // infinity and NaN: twice
  const uint32_t subnormal = bits_of(static_cast<float>(static_cast<int32_t>(magnitude)) * 0x1p-24f);
  return float_of(sign | (magnitude < 0x0400 ? subnormal : normal));
}
ANYNET_STATIC_INLINE float to_float(bfloat16 b) { return float_of(static_cast<uint32_t>(b.bits) << 16); }

/// Rounds to nearest even, as PyTorch does.
ANYNET_STATIC_INLINE float16 to_float16(float a) {
  const uint32_t sign = bits_of(a) >> 16 & 0x8000, magnitude = bits_of(a) & 0x7fffffff;
  const uint32_t rounding = 0x0fff + (magnitude >> 13 & 1);
  const uint32_t normal = (magnitude - ((127 - 15) << 23) + rounding) >> 13;
  // The last place of numbers from 0.5 to 1 is that of the subnormal ones, so the addition rounds.
  const uint32_t subnormal = bits_of(float_of(magnitude) + 0.5f) - bits_of(0.5f);
  uint32_t rounded = magnitude < bits_of(0x1p-14f) ? subnormal : normal;
  rounded = magnitude >= bits_of(65520) ? 0x7c00 : rounded;
  rounded = magnitude > 0x7f800000 ? 0x7e00 : rounded;
  return float16{static_cast<uint16_t>(sign | rounded)};
}
ANYNET_STATIC_INLINE bfloat16 to_bfloat16(float a) {
  const uint32_t bits = bits_of(a), rounded = (bits + 0x7fff + (bits >> 16 & 1)) >> 16;
  return bfloat16{static_cast<uint16_t>(a != a ? 0x7fc0 : rounded)};
}

}  // namespace anynet
