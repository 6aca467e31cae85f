// Sampling a row at positions shifted by a disparity, and the reverse: which pixels sampled here. For *_cuda.cu only.
#pragma once

#include "cuda.h"

namespace anynet::cuda {

/// Row (n, y) of one channel.
template <class T>
ANYNET_DEVICE const T* row_of(const View4<const T>& v, int64_t n, int64_t c, int64_t y) {
  return v.data + n * v.stride[0] + c * v.stride[1] + y * v.stride[2];
}

/// A position in a row: (1 - fraction) of pixel `index` and `fraction` of the next.
template <class A>
struct Position {
  int index;
  A fraction;
};

/// x - disparity - offset. The index is clamped to [lowest, highest], which the caller chooses so far outside the row
/// that only zeros are sampled there. NaN gives fraction NaN and index `lowest`.
template <class A>
ANYNET_DEVICE Position<A> locate(int x, A disparity, int64_t offset, int lowest, int highest) {
  const A huge = static_cast<A>(1e30), large = 1 << 30;
  const A shift = -disparity > huge ? huge : -disparity < -huge ? -huge : -disparity;  // infinity has no fraction
  const A whole = floor(shift);
  A index = whole - static_cast<A>(offset);
  index = index < large ? index : large;
  index = index > -large ? index : -large;  // NaN too
  const int64_t i = x + static_cast<int64_t>(index);
  return {static_cast<int>(i < lowest ? lowest : i > highest ? highest : i), shift - whole};
}

/// Pixel i of a row, 0 outside.
template <class T>
ANYNET_DEVICE accumulator_t<T> pixel(const T* row, int64_t stride, int i, int width) {
  return static_cast<unsigned>(i) < static_cast<unsigned>(width) ? read(row + i * stride) : accumulator_t<T>(0);
}

template <class A>
ANYNET_DEVICE A sample(Position<A> at, A pixel, A next) {
  return (1 - at.fraction) * pixel + at.fraction * next;
}

/// For a warp that owns the pixels [begin, begin + 32) of a row: calls body(x, position of x), with the same arguments
/// in every lane, for each x in [0, width) in order whose position, or one up to `reach` below it, touches those
/// pixels. `position(x)` tells where x samples. This turns the scatter of a backward pass into a gather without
/// atomics: a warp looks at 32 pixels at a time, and only spends time on those that matter.
template <class A, class PositionOf, class Body>
ANYNET_DEVICE void for_each_sampler(int begin, int width, int reach, const PositionOf& position, const Body& body) {
  const int lane = threadIdx.x % 32;
  for (int64_t base = 0; base < width; base += 32) {
    Position<A> mine{-2, 0};
    bool touches = false;
    if (base + lane < width) {
      mine = position(static_cast<int>(base) + lane);
      touches = mine.index + 1 >= begin && mine.index - reach < begin + 32 && mine.fraction == mine.fraction;
    }
    for (unsigned left = __ballot_sync(all_lanes, touches); left != 0; left &= left - 1) {
      const int source = __ffs(left) - 1;
      const Position<A> at{__shfl_sync(all_lanes, mine.index, source), __shfl_sync(all_lanes, mine.fraction, source)};
      body(static_cast<int>(base) + source, at);
    }
  }
}

inline void check_row(const char* name, int64_t width, int64_t count) {
  if (width + count >= 1 << 30) {
    throw std::runtime_error(std::string(name) + ": expected fewer than 2^30 pixels and offsets per row, got " +
                             std::to_string(width) + " and " + std::to_string(count));
  }
}

}  // namespace anynet::cuda
