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
  explicit Positions(int64_t width)
      : width_(width),
        fraction(round_up(width, lanes<A>)),
        index(round_up(width, lanes<A>)),
        window(round_up(width, lanes<A>) / lanes<A>) {
    fill_zero<A>(fraction, round_up(width, lanes<A>));
  }

  template <class T>
  void read(const T* disparity, int64_t stride, int64_t offset, int32_t lowest, int32_t highest) {
    constexpr A large = 1 << 30;
    const A* d = read_row(disparity, stride, width_, static_cast<A*>(fraction));
    const A shift = static_cast<A>(offset);
#pragma omp simd
    for (int64_t x = 0; x < width_; ++x) {
      const A value = -d[x];
      A p = value < large ? value : large;  // NaN: `large`, for now
      p = p > -large ? p : -large;
      A whole = static_cast<A>(static_cast<int32_t>(p));
      whole = whole > p ? whole - 1 : whole;
      A moved = whole - shift;
      moved = moved < large ? moved : large;
      moved = moved > -large ? moved : -large;
      int32_t i = static_cast<int32_t>(x) + static_cast<int32_t>(moved);
      i = i < lowest ? lowest : i;
      i = i > highest ? highest : i;
      index[x] = value == value ? i : lowest;
      fraction[x] = value == value ? p - whole : value;
    }
    for (int64_t x = width_; x < round_up(width_, lanes<A>); ++x) index[x] = index[width_ - 1];
    for (int64_t x = 0; x < width_; x += lanes<A>) {
      int32_t low = INT32_MAX, high = INT32_MIN;
#pragma omp simd reduction(min : low) reduction(max : high)
      for (int64_t i = 0; i < lanes<A>; ++i) {
        low = index[x + i] < low ? index[x + i] : low;
        high = index[x + i] > high ? index[x + i] : high;
      }
      window[x / lanes<A>] = high - low < 2 * lanes<A> ? low : no_window;
    }
  }

  static constexpr int32_t no_window = INT32_MIN;

 private:
  const int64_t width_;

 public:
  Scratch<A> fraction;
  Scratch<int32_t> index;
  Scratch<int32_t> window;  // per vector of pixels: its lowest index, if all lie within two vectors from there
};

/// The elements of a row at one vector of pixels' indices, moved by some columns: neighbouring pixels mostly read
/// neighbouring elements, which two loads and a permutation gather.
template <class A>
class Windowed {
 public:
  ANYNET_INLINE Windowed(const Positions<A>& at, int64_t x) : low_(at.window[x / lanes<A>]) {
    typedef int32_t Indices __attribute__((vector_size(lanes<A> * sizeof(int32_t))));
    Indices indices;
    std::memcpy(&indices, at.index + x, sizeof(indices));
    select_ = __builtin_convertvector(indices - static_cast<int32_t>(low_), typename Simd<A>::mask);
  }
  ANYNET_INLINE vec<A> operator()(const A* row, int64_t move) const {
    const A* p = row + low_ + move;
    return __builtin_shuffle(load(p), load(p + lanes<A>), select_);
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
  ANYNET_INLINE vec<A> operator()(const A* row, int64_t move) const {
    A gathered[lanes<A>];
    for (int64_t i = 0; i < lanes<A>; ++i) gathered[i] = row[index_[i] + move];
    return load(gathered);
  }

 private:
  const int32_t* index_;
};

/// Calls body with the gatherer that fits the vector of pixels at x.
template <class A, class Body>
ANYNET_INLINE void gather_at(const Positions<A>& at, int64_t x, const Body& body) {
  // Permutations by variable indices begin with AVX2.
  if (vector_bytes > 16 && at.window[x / lanes<A>] != Positions<A>::no_window) {
    body(Windowed<A>(at, x));
  } else {
    body(Gathered<A>(at, x));
  }
}

}  // namespace anynet::ANYNET_ISA
