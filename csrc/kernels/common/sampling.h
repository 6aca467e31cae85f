// Where the pixels of a row are sampled. Included by files that are compiled per instruction set.
#pragma once

#include <cstdint>

#include "simd.h"

namespace anynet::ANYNET_ISA {

/// Splits the positions x - disparity[x] - offset, x in [0, width), into index + fraction with 0 <= fraction <= 1.
/// Indices are clamped to [lowest, highest], which the caller chooses so far outside the row that nothing but zeros is
/// sampled there. A NaN gives fraction NaN and index `lowest`.
template <class A>
ANYNET_INLINE void split_positions(const A* disparity, int64_t width, int64_t offset, int32_t lowest, int32_t highest,
                                   int32_t* index, A* fraction) {
  constexpr A huge = 1e30, large = 1 << 30;
  for (int64_t x = 0; x < width; ++x) {
    A d = -disparity[x];
    d = d > huge ? huge : d;  // no infinity, which has no fraction
    d = d < -huge ? -huge : d;
    const A whole = sizeof(A) == 4 ? static_cast<A>(__builtin_floorf(d)) : static_cast<A>(__builtin_floor(d));
    fraction[x] = d - whole;
    A shift = whole - static_cast<A>(offset);
    shift = shift < large ? shift : large;
    shift = shift > -large ? shift : -large;  // NaN too
    const int32_t i = static_cast<int32_t>(x) + static_cast<int32_t>(shift);
    index[x] = i < lowest ? lowest : i > highest ? highest : i;
  }
}

}  // namespace anynet::ANYNET_ISA
