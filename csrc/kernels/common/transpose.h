// Square tiles, transposed in registers. Included by files that are compiled per instruction set.
#pragma once

#include "simd.h"

namespace anynet::ANYNET_ISA {

/// Transposes rows[lanes<A>] of lanes<A> elements.
template <class A>
ANYNET_INLINE void transpose(vec<A>* rows) {
  using mask = typename Simd<A>::mask;
  constexpr int L = lanes<A>;
  mask low{}, high{};
  for (int i = 0; i < L; ++i) {
    low[i] = i / 2 + i % 2 * L;
    high[i] = low[i] + L / 2;
  }
  // Each round interleaves the first half of the rows with the second; log2(L) rounds transpose.
  for (int round = 1; round < L; round *= 2) {
    vec<A> mixed[L];
    for (int i = 0; i < L / 2; ++i) {
      mixed[2 * i] = __builtin_shuffle(rows[i], rows[i + L / 2], low);
      mixed[2 * i + 1] = __builtin_shuffle(rows[i], rows[i + L / 2], high);
    }
    for (int i = 0; i < L; ++i) rows[i] = mixed[i];
  }
}

}  // namespace anynet::ANYNET_ISA
