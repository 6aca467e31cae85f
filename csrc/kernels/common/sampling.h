// Rows sampled at positions between their pixels. Included by files that are compiled per instruction set.
#pragma once

#include <cstdint>
#include <cstring>

#include "scratch.h"
#include "simd.h"

namespace anynet::ANYNET_ISA {

/// Where a row is sampled: at position index[x] + fraction[x], 0 <= fraction <= 1, which is x - disparity[x] - offset.
/// The indices are clamped to [lowest, highest], so far outside the row that nothing but zeros is sampled there. A NaN
/// gives fraction NaN and index `lowest`.
template <class A>
class Positions {
 public:
  using Indices = typename Simd<A>::indices;

  explicit Positions(int64_t width)
      : width_(width),
        fraction(round_up(width, lanes<A>)),
        index(round_up(width, lanes<A>)),
        window(round_up(width, lanes<A>) / lanes<A>),
        consecutive(round_up(width, lanes<A>) / lanes<A>) {}

  template <class T>
  void read(const T* disparity, int64_t stride, int64_t offset, int32_t lowest, int32_t highest) {
    const vec<A> large = splat(A(1 << 30));
    const A* d = read_row(disparity, stride, width_, static_cast<A*>(fraction));
    const A shift = static_cast<A>(offset);
    Indices column;
    for (int i = 0; i < lanes<A>; ++i) column[i] = i;
    for (int64_t x = 0; x < width_; x += lanes<A>, column += lanes<A>) {
      const vec<A> value = -read_vector<A>(d + x, 1, width_ - x < lanes<A> ? width_ - x : lanes<A>);
      const auto bounded = [&](vec<A> v) { return max<A>(min<A>(v, large), -large); };  // NaN: `large`
      const vec<A> p = bounded(value);
      vec<A> whole = __builtin_convertvector(__builtin_convertvector(p, Indices), vec<A>);
      whole -= whole > p ? splat<A>(1) : vec<A>{};
      Indices i = column + __builtin_convertvector(bounded(whole - shift), Indices);
      i = i < lowest ? lowest + Indices{} : i;
      i = i > highest ? highest + Indices{} : i;
      const Indices known = __builtin_convertvector(value == value, Indices);
      i = (i & known) | (lowest & ~known);
      std::memcpy(index + x, &i, sizeof(i));
      store(fraction + x, value == value ? p - whole : value);
    }
    for (int64_t x = width_; x < round_up(width_, lanes<A>); ++x) {
      index[x] = index[width_ - 1];
      fraction[x] = 0;
    }
    for (int64_t x = 0; x < width_; x += lanes<A>) {
      int32_t low = INT32_MAX, high = INT32_MIN;
#pragma omp simd reduction(min : low) reduction(max : high)
      for (int64_t i = 0; i < lanes<A>; ++i) {
        low = index[x + i] < low ? index[x + i] : low;
        high = index[x + i] > high ? index[x + i] : high;
      }
      window[x / lanes<A>] = high - low + neighbors <= 2 * lanes<A> ? low : no_window;
      bool ascending = true;
      for (int i = 1; i < lanes<A>; ++i) ascending &= index[x + i] == index[x] + i;
      consecutive[x / lanes<A>] = ascending;
    }
  }

  static constexpr int32_t no_window = INT32_MIN;
  static constexpr int neighbors = 6;  // elements from each position's on that the same two vectors shall hold

 private:
  const int64_t width_;

 public:
  Scratch<A> fraction;
  Scratch<int32_t> index;
  Scratch<int32_t> window;       // per vector of pixels: its lowest index, if the others are near enough
  Scratch<uint8_t> consecutive;  // per vector: whether each index is the one before it plus 1
};

/// Zeros that a row needs before and after it, if indices -2 to W + 1 are sampled: two vectors are read from some index
/// on.
template <class A>
constexpr int64_t sampled_beside = 2 * lanes<A> + 2;

/// The elements of a row at one vector of pixels' indices and beside them, if the indices are consecutive.
template <class A>
class Consecutive {
 public:
  ANYNET_INLINE Consecutive(const Positions<A>& at, int64_t x) : first_(at.index[x]) {}
  /// The elements at the indices plus move, plus move - 1, ... plus move - n + 1.
  template <int n>
  ANYNET_INLINE void descending(const A* row, int64_t move, vec<A>* out) const {
    for (int i = 0; i < n; ++i) out[i] = load(row + first_ + move - i);
  }

 private:
  const int64_t first_;
};

/// The same for indices that are near each other, whose elements two loads and permutations gather.
template <class A>
class Windowed {
 public:
  ANYNET_INLINE Windowed(const Positions<A>& at, int64_t x) : low_(at.window[x / lanes<A>]) {
    typename Positions<A>::Indices indices;
    std::memcpy(&indices, at.index + x, sizeof(indices));
    select_ = __builtin_convertvector(indices - static_cast<int32_t>(low_), typename Simd<A>::mask);
  }
  template <int n>
  ANYNET_INLINE void descending(const A* row, int64_t move, vec<A>* out) const {
    static_assert(n <= Positions<A>::neighbors);
    const A* p = row + low_ + move - (n - 1);
    const vec<A> first = load(p), second = load(p + lanes<A>);
    for (int i = 0; i < n; ++i) out[i] = shuffle<A>(first, second, select_ + (n - 1 - i));
  }

 private:
  const int64_t low_;
  typename Simd<A>::mask select_;
};

/// The same for any indices.
template <class A>
class Gathered {
 public:
  Gathered(const Positions<A>& at, int64_t x) : index_(at.index + x) {}
  template <int n>
  ANYNET_INLINE void descending(const A* row, int64_t move, vec<A>* out) const {
    for (int j = 0; j < n; ++j) {
      A gathered[lanes<A>];
      for (int64_t i = 0; i < lanes<A>; ++i) gathered[i] = row[index_[i] + move - j];
      out[j] = load(gathered);
    }
  }

 private:
  const int32_t* index_;
};

/// Calls body with the gatherer that fits the vector of pixels at x.
template <class A, class Body>
ANYNET_INLINE void gather_at(const Positions<A>& at, int64_t x, const Body& body) {
  constexpr bool permutes = vector_bytes > 16;  // by variable indices, from AVX2 on
  if (at.consecutive[x / lanes<A>]) {           // where the disparity's whole part stays the same
    body(Consecutive<A>(at, x));
  } else if (permutes && at.window[x / lanes<A>] != Positions<A>::no_window) {
    body(Windowed<A>(at, x));
  } else {
    body(Gathered<A>(at, x));
  }
}

}  // namespace anynet::ANYNET_ISA
