// exp for vectors. Included by files that are compiled per instruction set.
#pragma once

#include "simd.h"

namespace anynet::ANYNET_ISA {

template <class A>
struct ExpConstants;
template <>
struct ExpConstants<float> {
  // ln 2 = ln2_high + ln2_low, and n * ln2_high is exact for every exponent n.
  static constexpr float ln2_high = 0x1.62e4p-1f, ln2_low = 0x1.7f7d1cp-20f;
  static constexpr float rounder = 0x1.8p23f;  // adding it leaves an integer in the low bits
  static constexpr float lowest = -87.0f;      // e^lowest is still a normal number
  static constexpr int degree = 7, mantissa_bits = 23;
};
template <>
struct ExpConstants<double> {
  static constexpr double ln2_high = 0x1.62e42fep-1, ln2_low = 0x1.f473de6af278fp-30;
  static constexpr double rounder = 0x1.8p52;
  static constexpr double lowest = -708.0;
  static constexpr int degree = 13, mantissa_bits = 52;
};

constexpr double inverse_factorial(int n) { return n == 0 ? 1.0 : inverse_factorial(n - 1) / n; }

/// e^x for x <= 0, within 2 units in the last place; 0 below `lowest` (-87 or -708), NaN for NaN.
template <class A>
ANYNET_INLINE vec<A> exp_nonpositive(vec<A> x) {
  using Constants = ExpConstants<A>;
  using mask = typename Simd<A>::mask;
  // x = n ln 2 + r, |r| <= ln 2 / 2: the Taylor series of e^r, times 2^n put into the exponent.
  const vec<A> clamped = x < Constants::lowest ? splat<A>(Constants::lowest) : x;
  const vec<A> shifted = clamped * A(1.44269504088896340736) + Constants::rounder;
  const vec<A> n = shifted - Constants::rounder;
  const vec<A> r = (clamped - n * Constants::ln2_high) - n * Constants::ln2_low;
  vec<A> sum = splat<A>(static_cast<A>(inverse_factorial(Constants::degree)));
  for (int i = Constants::degree - 1; i >= 0; --i) sum = sum * r + static_cast<A>(inverse_factorial(i));
  const mask bits = reinterpret_cast<mask>(sum) + (reinterpret_cast<mask>(shifted) << Constants::mantissa_bits);
  return x < Constants::lowest ? vec<A>{} : x == x ? reinterpret_cast<vec<A>>(bits) : x;
}

}  // namespace anynet::ANYNET_ISA
