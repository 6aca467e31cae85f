// exp for vectors. Included by files that are compiled per instruction set.
#pragma once

#include "simd.h"

namespace anynet::ANYNET_ISA {

template <class A>
struct ExpConstants;

constexpr double inverse_factorial(int n) { return n == 0 ? 1.0 : inverse_factorial(n - 1) / n; }

template <>
struct ExpConstants<float> {
  typedef uint32_t bits __attribute__((vector_size(vector_bytes)));
  // ln 2 = ln2_high + ln2_low, and n * ln2_high is exact for every exponent n.
  static constexpr float ln2_high = 0x1.62e4p-1f, ln2_low = 0x1.7f7d1cp-20f;
  static constexpr float rounder = 0x1.8p23f;  // adding it leaves an integer in the low bits
  static constexpr float lowest = -87.0f;      // e^lowest is still a normal number
  static constexpr int degree = 6, mantissa_bits = 23;
  // Of e^r for |r| <= ln 2 / 2, relative error 2e-9 (Remez), 1 at 0.
  static constexpr float series[] = {1.0f,           1.0f,           0x1.fffffap-2f, 0x1.55540ap-3f,
                                     0x1.55589cp-5f, 0x1.126d64p-7f, 0x1.6ab928p-10f};
};
template <>
struct ExpConstants<double> {
  typedef uint64_t bits __attribute__((vector_size(vector_bytes)));
  static constexpr double ln2_high = 0x1.62e42fep-1, ln2_low = 0x1.f473de6af278fp-30;
  static constexpr double rounder = 0x1.8p52;
  static constexpr double lowest = -708.0;
  static constexpr int degree = 13, mantissa_bits = 52;
  static constexpr double series[] = {1.0,
                                      1.0,
                                      inverse_factorial(2),
                                      inverse_factorial(3),
                                      inverse_factorial(4),
                                      inverse_factorial(5),
                                      inverse_factorial(6),
                                      inverse_factorial(7),
                                      inverse_factorial(8),
                                      inverse_factorial(9),
                                      inverse_factorial(10),
                                      inverse_factorial(11),
                                      inverse_factorial(12),
                                      inverse_factorial(13)};
};

/// x, but where it is below `lowest`: anything for which e^x can be computed, since `scaled` gives 0 there.
template <class A>
ANYNET_INLINE vec<A> not_below_lowest(vec<A> x) {
#if defined(__AVX512F__)
  if constexpr (sizeof(A) == 4) return x;
#endif
  return x < ExpConstants<A>::lowest ? splat<A>(ExpConstants<A>::lowest) : x;
}

/// sum * 2^n where x is not below `lowest`, else 0; NaN where x is NaN. `shifted` holds n in its low bits.
template <class A>
ANYNET_INLINE vec<A> scaled(vec<A> sum, [[maybe_unused]] vec<A> n, vec<A> shifted, vec<A> x) {
#if defined(__AVX512F__)
  if constexpr (sizeof(A) == 4) {
    const __mmask16 on =
        _mm512_cmp_ps_mask(reinterpret_cast<__m512>(x), _mm512_set1_ps(ExpConstants<A>::lowest), _CMP_NLT_UQ);
    return reinterpret_cast<vec<A>>(
        _mm512_maskz_scalef_ps(on, reinterpret_cast<__m512>(sum), reinterpret_cast<__m512>(n)));
  }
#endif
  // Unsigned: where x is NaN, so is `shifted`, and any bits may overflow.
  using bits = typename ExpConstants<A>::bits;
  const bits product =
      reinterpret_cast<bits>(sum) + (reinterpret_cast<bits>(shifted) << ExpConstants<A>::mantissa_bits);
  return x < ExpConstants<A>::lowest ? vec<A>{} : x == x ? reinterpret_cast<vec<A>>(product) : x;
}

/// e^x for x <= 0, within 2 units in the last place; 0 below `lowest` (-87 or -708), NaN for NaN.
template <class A>
ANYNET_INLINE vec<A> exp_nonpositive(vec<A> x) {
  using Constants = ExpConstants<A>;
  // x = n ln 2 + r, |r| <= ln 2 / 2: a polynomial for e^r, times 2^n.
  const vec<A> clamped = not_below_lowest<A>(x);
  const vec<A> shifted = clamped * A(1.44269504088896340736) + Constants::rounder;
  const vec<A> n = shifted - Constants::rounder;
  const vec<A> r = (clamped - n * Constants::ln2_high) - n * Constants::ln2_low;
  vec<A> sum = splat<A>(Constants::series[Constants::degree]);
  for (int i = Constants::degree - 1; i >= 0; --i) sum = sum * r + Constants::series[i];
  return scaled<A>(sum, n, shifted, x);
}

}  // namespace anynet::ANYNET_ISA
