// Vectors of the instruction set that this translation unit is compiled for, and rows read into them.
// Only files compiled per instruction set may include this: everything here lives in that set's namespace, so the
// linker can never merge code of one set with another's.
#pragma once

#include <cstdint>
#include <cstring>
#include <type_traits>

#include "half.h"
#include "tensor.h"

#if defined(__AVX2__)
#include <immintrin.h>
#endif

#define ANYNET_INLINE inline __attribute__((always_inline))

namespace anynet::ANYNET_ISA {

#if defined(__AVX512F__)
constexpr int vector_bytes = 64;
#elif defined(__AVX2__)
constexpr int vector_bytes = 32;
#else
constexpr int vector_bytes = 16;
#endif

template <class A>
struct Simd;
template <>
struct Simd<float> {
  typedef float vec __attribute__((vector_size(vector_bytes)));
  typedef int32_t mask __attribute__((vector_size(vector_bytes)));
  typedef int32_t indices __attribute__((vector_size(vector_bytes)));
};
template <>
struct Simd<double> {
  typedef double vec __attribute__((vector_size(vector_bytes)));
  typedef int64_t mask __attribute__((vector_size(vector_bytes)));
  typedef int32_t indices __attribute__((vector_size(vector_bytes / 2)));
};
template <class A>
using vec = typename Simd<A>::vec;
template <class A>
constexpr int lanes = vector_bytes / sizeof(A);

template <class A>
ANYNET_INLINE vec<A> load(const A* p) {
  vec<A> v;
  std::memcpy(&v, p, sizeof(v));
  return v;
}
template <class A>
ANYNET_INLINE void store(A* p, vec<A> v) {
  std::memcpy(p, &v, sizeof(v));
}
template <class A>
ANYNET_INLINE vec<A> splat(A a) {
  return a - vec<A>{};
}

/// sum += a * b. With 16 registers and an instruction for it, all three are in registers: left to itself, the compiler
/// reads `a` and `b` from memory each time that they are needed, more often than the processor can, or keeps a sum
/// there.
#if defined(__AVX2__) && !defined(__AVX512F__)
constexpr bool in_registers = true;
template <class A>
ANYNET_INLINE void add_product(vec<A>& sum, const vec<A>& a, const vec<A>& b) {
  if constexpr (sizeof(A) == 4) {
    asm("vfmadd231ps %2, %1, %0" : "+x"(sum) : "x"(a), "x"(b));
  } else {
    asm("vfmadd231pd %2, %1, %0" : "+x"(sum) : "x"(a), "x"(b));
  }
}
#else
constexpr bool in_registers = false;
template <class A>
ANYNET_INLINE void add_product(vec<A>& sum, const vec<A>& a, const vec<A>& b) {
  sum += a * b;
}
#endif

template <class A>
ANYNET_INLINE vec<A> absolute(vec<A> v) {
  using mask = typename Simd<A>::mask;
  return reinterpret_cast<vec<A>>(reinterpret_cast<mask>(v) & ~reinterpret_cast<mask>(splat<A>(-A(0))));
}

/// The smaller of each pair; `b` where an element is NaN.
template <class A>
ANYNET_INLINE vec<A> min(vec<A> a, vec<A> b) {
#if defined(__AVX512F__)
  if constexpr (sizeof(A) == 4) {
    constexpr __mmask16 all = 0xffff;
    return reinterpret_cast<vec<A>>(_mm512_maskz_min_ps(all, reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b)));
  }
#endif
  return a < b ? a : b;
}

/// The larger of each pair; `b` where an element is NaN.
template <class A>
ANYNET_INLINE vec<A> max(vec<A> a, vec<A> b) {
  return a > b ? a : b;
}

/// The elements I... of `a` followed by `b`.
template <int... I, class V>
ANYNET_INLINE V shuffle(V a, V b) {
#if defined(__clang__) || __GNUC__ >= 12
  return __builtin_shufflevector(a, b, I...);
#else
  using mask = decltype(a == b);
  return __builtin_shuffle(a, b, mask{I...});
#endif
}

/// The same with indices that are not known before.
template <class A>
ANYNET_INLINE vec<A> shuffle(vec<A> a, vec<A> b, typename Simd<A>::mask indices) {
#if !defined(__clang__)
  return __builtin_shuffle(a, b, indices);
#else
#if defined(__AVX2__)
  if constexpr (lanes<A> == 8 && sizeof(A) == 4) {
    const auto i = reinterpret_cast<__m256i>(indices);
    const __m256 from_a = _mm256_permutevar8x32_ps(reinterpret_cast<__m256>(a), i);
    const __m256 from_b = _mm256_permutevar8x32_ps(reinterpret_cast<__m256>(b), i);
    return indices < lanes<A> ? reinterpret_cast<vec<A>>(from_a) : reinterpret_cast<vec<A>>(from_b);
  }
#endif
#if defined(__AVX512F__)
  if constexpr (sizeof(A) == 4) {
    return reinterpret_cast<vec<A>>(_mm512_permutex2var_ps(
        reinterpret_cast<__m512>(a), reinterpret_cast<__m512i>(indices), reinterpret_cast<__m512>(b)));
  }
#endif
  A all[2 * lanes<A>], out[lanes<A>];
  store(all, a);
  store(all + lanes<A>, b);
  for (int i = 0; i < lanes<A>; ++i) out[i] = all[indices[i]];
  return load(out);
#endif
}

/// A number as a type, for templates.
template <int value>
struct Constant {
  constexpr int operator()() const { return value; }
};

constexpr int64_t round_up(int64_t count, int64_t step) { return (count + step - 1) / step * step; }

/// Which lanes [first, end) a load reads. It leaves the others 0 and does not touch their memory.
#if defined(__AVX512F__)
template <class A>
struct LaneRange {
  uint16_t on;
  LaneRange(int first, int end) : on(static_cast<uint16_t>(((1u << end) - 1) & ~((1u << first) - 1))) {}
};
ANYNET_INLINE vec<float> load(const float* p, LaneRange<float> lanes) {
  return reinterpret_cast<vec<float>>(_mm512_maskz_loadu_ps(lanes.on, p));
}
ANYNET_INLINE vec<double> load(const double* p, LaneRange<double> lanes) {
  return reinterpret_cast<vec<double>>(_mm512_maskz_loadu_pd(static_cast<uint8_t>(lanes.on), p));
}
#elif defined(__AVX2__)
/// As many zeros as a vector has lanes, as many ones (all bits), and zeros again: a mask is a window of them.
template <class A>
struct Ones {
  std::remove_reference_t<decltype(typename Simd<A>::mask{}[0])> at[3 * lanes<A>]{};
  constexpr Ones() {
    for (int i = 0; i < lanes<A>; ++i) at[lanes<A> + i] = -1;
  }
};
template <class A>
inline constexpr Ones<A> ones;

template <class A>
struct LaneRange {
  typename Simd<A>::mask on;
  LaneRange(int first, int end) {
    typename Simd<A>::mask before_end;
    std::memcpy(&on, ones<A>.at + lanes<A> - first, sizeof(on));
    std::memcpy(&before_end, ones<A>.at + 2 * lanes<A> - end, sizeof(on));
    on &= before_end;
  }
};
ANYNET_INLINE vec<float> load(const float* p, LaneRange<float> lanes) {
  return reinterpret_cast<vec<float>>(_mm256_maskload_ps(p, reinterpret_cast<__m256i>(lanes.on)));
}
ANYNET_INLINE vec<double> load(const double* p, LaneRange<double> lanes) {
  return reinterpret_cast<vec<double>>(_mm256_maskload_pd(p, reinterpret_cast<__m256i>(lanes.on)));
}
#else
template <class A>
struct LaneRange {
  int first, end;
  LaneRange(int first, int end) : first(first), end(end) {}
};
template <class A>
ANYNET_INLINE vec<A> load(const A* p, LaneRange<A> range) {
  if (range.end - range.first == lanes<A>) return load(p);
  vec<A> v{};
  for (int i = range.first; i < range.end; ++i) v[i] = p[i];
  return v;
}
#endif

/// In place of a LaneRange of all lanes: a load like any other, which is faster.
struct AllLanes {};
template <class A>
ANYNET_INLINE vec<A> load(const A* p, AllLanes) {
  return load(p);
}

ANYNET_INLINE float to_accumulator(float a) { return a; }
ANYNET_INLINE double to_accumulator(double a) { return a; }
ANYNET_INLINE float to_accumulator(float16 a) { return to_float(a); }
ANYNET_INLINE float to_accumulator(bfloat16 a) { return to_float(a); }

/// Rounds to nearest even, as PyTorch does.
template <class T>
ANYNET_INLINE T from_accumulator(accumulator_t<T> a) {
  return a;
}
template <>
ANYNET_INLINE float16 from_accumulator<float16>(float a) {
  return to_float16(a);
}
template <>
ANYNET_INLINE bfloat16 from_accumulator<bfloat16>(float a) {
  return to_bfloat16(a);
}

/// `count` elements, `stride` apart, as contiguous accumulators: in place where they are that already, else copied
/// to `scratch`. This is how kernels take every element type and layout with one inner loop.
template <class T>
ANYNET_INLINE const accumulator_t<T>* read_row(const T* p, int64_t stride, int64_t count, accumulator_t<T>* scratch) {
  if constexpr (sizeof(T) == sizeof(accumulator_t<T>)) {
    if (stride == 1) return p;
  }
  if (stride == 1) {
    for (int64_t i = 0; i < count; ++i) scratch[i] = to_accumulator(p[i]);
  } else {
    for (int64_t i = 0; i < count; ++i) scratch[i] = to_accumulator(p[i * stride]);
  }
  return scratch;
}

/// The same, always copied to `out`.
template <class T>
ANYNET_INLINE void copy_row(const T* p, int64_t stride, int64_t count, accumulator_t<T>* out) {
  const accumulator_t<T>* row = read_row(p, stride, count, out);
  if (row != out) std::memcpy(out, row, count * sizeof(*out));
}

template <class T>
ANYNET_INLINE void write_row(const accumulator_t<T>* row, int64_t count, T* p) {
  for (int64_t i = 0; i < count; ++i) p[i] = from_accumulator<T>(row[i]);
}

/// Up to a vector of elements, `stride` apart, with zeros behind them.
template <class T>
ANYNET_INLINE vec<accumulator_t<T>> read_vector(const T* p, int64_t stride, int64_t count) {
  using A = accumulator_t<T>;
  if constexpr (sizeof(T) == sizeof(A)) {
    if (stride == 1 && count == lanes<A>) return load<A>(p);
  }
  A row[lanes<A>] = {};
  copy_row(p, stride, count, row);
  return load(row);
}

/// The first `count` lanes of `v`.
template <class T>
ANYNET_INLINE void write_vector(vec<accumulator_t<T>> v, int64_t count, T* p) {
  using A = accumulator_t<T>;
  if constexpr (sizeof(T) == sizeof(A)) {
    if (count == lanes<A>) return store<A>(p, v);
  }
  A row[lanes<A>];
  store(row, v);
  write_row<T>(row, count, p);
}

}  // namespace anynet::ANYNET_ISA
