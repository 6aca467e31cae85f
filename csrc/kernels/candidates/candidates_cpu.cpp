#include <algorithm>

#include "../common/exp.h"
#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "../cost_volume/cost_volume.h"
#include "candidates.h"

namespace anynet::ANYNET_ISA {
namespace {

/// The largest and the smallest disparity around each pixel, to out [2,H,W].
template <class T>
void window_extremes(const CandidateCosts<T>& a, T* out, int threads) {
  const int64_t r = a.radius, padded = a.width + 2 * r, pixels = a.height * a.width;
  parallel_ranges(a.height, useful_threads(threads, pixels, r, 8), [&](int64_t begin, int64_t end) {
    const Scratch<T> columns(padded);
    for (int64_t y = begin; y < end; ++y) {
      const int64_t top = std::max<int64_t>(y - r, 0), bottom = std::min(y + r, a.height - 1);
      const auto reduce = [&](auto better, T* __restrict row_out) {
        std::copy_n(a.disparity + top * a.width, a.width, columns + r);
        for (int64_t j = top + 1; j <= bottom; ++j) {
          const T* row = a.disparity + j * a.width;
          for (int64_t x = 0; x < a.width; ++x) columns[r + x] = better(columns[r + x], row[x]);
        }
        // Replicating the border changes no extreme.
        for (int64_t x = 0; x < r; ++x) columns[x] = columns[r];
        for (int64_t x = r + a.width; x < padded; ++x) columns[x] = columns[r + a.width - 1];
        std::copy_n(static_cast<const T*>(columns), a.width, row_out);
        for (int64_t i = 1; i <= 2 * r; ++i) {
          for (int64_t x = 0; x < a.width; ++x) row_out[x] = better(row_out[x], columns[x + i]);
        }
      };
      reduce([](T p, T q) { return p < q ? q : p; }, out + y * a.width);
      reduce([](T p, T q) { return q < p ? q : p; }, out + pixels + y * a.width);
    }
  });
}

/// The cost volumes [groups,count,H,W] of all groups around a map.
template <class T>
void group_costs(const CandidateCosts<T>& a, const T* disparity, int64_t first, int64_t count, T* out, int threads) {
  const int64_t pixels = a.height * a.width, channels = a.channels / a.groups;
  // Each group's channels go as one sample of a batch, all around the same map.
  const View4<const T> left{
      a.features, {a.groups, channels, a.height, a.width}, {channels * pixels, pixels, a.width, 1}};
  View4<const T> right = left;
  right.data += a.channels * pixels;
  const View4<const T> around{disparity, {a.groups, 1, a.height, a.width}, {0, pixels, a.width, 1}};
  cost_volume<T>(CostVolume<T>{left, right, around, first, count, out}, threads);
}

}  // namespace

template <class T>
void candidate_costs(const CandidateCosts<T>& a, int threads) {
  const int64_t pixels = a.height * a.width;
  T* max_costs = a.out + a.groups * a.count * pixels;
  T* min_costs = max_costs + a.groups * pixels;
  T* left = min_costs + a.groups * pixels;
  T* extremes = left + a.channels * pixels;
  window_extremes(a, extremes, threads);
  group_costs(a, a.disparity, a.first, a.count, a.out, threads);
  group_costs(a, extremes, 0, 1, max_costs, threads);
  group_costs(a, extremes + pixels, 0, 1, min_costs, threads);
  parallel_ranges(pixels, useful_threads(threads, pixels, a.channels), [&](int64_t begin, int64_t end) {
    for (int64_t c = 0; c < a.channels; ++c) {
      std::copy(a.features + c * pixels + begin, a.features + c * pixels + end, left + c * pixels + begin);
    }
    for (int64_t k = 0; k < 2; ++k) {
      T* __restrict offsets = extremes + k * pixels;
      for (int64_t i = begin; i < end; ++i) offsets[i] -= a.disparity[i];
    }
  });
}

template <class T>
void expected_disparity(const ExpectedDisparity<T>& a, int threads) {
  const int64_t vectors = (a.pixels + lanes<T> - 1) / lanes<T>;
  parallel_ranges(vectors, useful_threads(threads, a.pixels, a.count, 8), [&](int64_t begin, int64_t end) {
    for (int64_t v = begin; v < end; ++v) {
      const int64_t i = v * lanes<T>, n = std::min<int64_t>(a.pixels - i, lanes<T>);
      const auto read = [&](const T* plane) { return n == lanes<T> ? load(plane + i) : read_vector(plane + i, 1, n); };
      vec<T> least = read(a.cost);
      for (int64_t k = 1; k < a.count; ++k) least = min<T>(least, read(a.cost + k * a.pixels));
      vec<T> sum{}, mean{};
      for (int64_t k = 0; k < a.count; ++k) {
        const int64_t offset = k - (a.count - 2);
        const vec<T> weight = exp_nonpositive<T>(least - read(a.cost + k * a.pixels));
        sum += weight;
        mean += weight * (offset < 0 ? splat(a.first + static_cast<T>(k)) : read(a.offsets + offset * a.pixels));
      }
      const vec<T> out = read(a.disparity) + mean / sum;
      std::memcpy(a.out + i, &out, n * sizeof(T));
    }
  });
}

template void candidate_costs<float>(const CandidateCosts<float>&, int);
template void expected_disparity<float>(const ExpectedDisparity<float>&, int);

}  // namespace anynet::ANYNET_ISA
