// Square tiles, transposed in registers. Included by files that are compiled per instruction set.
#pragma once

#include <utility>

#include "simd.h"

namespace anynet::ANYNET_ISA {

template <class A, int... I>
ANYNET_INLINE void transpose(vec<A>* rows, std::integer_sequence<int, I...>) {
  constexpr int L = lanes<A>;
  // Each round interleaves the first half of the rows with the second; log2(L) rounds transpose.
  for (int round = 1; round < L; round *= 2) {
    vec<A> mixed[L];
    for (int i = 0; i < L / 2; ++i) {
      mixed[2 * i] = shuffle<(I / 2 + I % 2 * L)...>(rows[i], rows[i + L / 2]);
      mixed[2 * i + 1] = shuffle<(L / 2 + I / 2 + I % 2 * L)...>(rows[i], rows[i + L / 2]);
    }
    for (int i = 0; i < L; ++i) rows[i] = mixed[i];
  }
}

/// Transposes rows[lanes<A>] of lanes<A> elements.
template <class A>
ANYNET_INLINE void transpose(vec<A>* rows) {
  transpose<A>(rows, std::make_integer_sequence<int, lanes<A>>{});
}

}  // namespace anynet::ANYNET_ISA
