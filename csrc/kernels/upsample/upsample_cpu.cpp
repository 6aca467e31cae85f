#include <algorithm>
#include <utility>

#include "../common/interpolation.h"
#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "upsample.h"

namespace anynet::ANYNET_ISA {
namespace {

/// sum[x] += the line, upsampled `ratio` times, at x - ratio / 2: then output pixels 0 to ratio - 1 lie between
/// elements 0 and 1, at (k + 1/2) / ratio, and so on. `ratio` is `Ratio`, or a vector's lanes or more.
template <int Ratio, class T, int... I>
void add_upsampled(const T* line, int64_t ratio, int64_t count, T* __restrict sum, std::integer_sequence<int, I...>) {
  const T each = T(1) / static_cast<T>(ratio);
  const vec<T> fraction = {(static_cast<T>(I % Ratio) + T(0.5)) * each...};
  for (int64_t x = 0; x < count; x += lanes<T>) {
    const T* from = line + x / ratio;
    vec<T> left, right, at = fraction;
    if constexpr (Ratio < lanes<T>) {
      const vec<T> both = load(from), next = load(from + 1);
      left = shuffle<(I / Ratio)...>(both, both);
      right = shuffle<(I / Ratio)...>(next, next);
    } else {
      left = splat(from[0]), right = splat(from[1]);
      at += static_cast<T>(x % ratio) * each;
    }
    store(sum + x, load(sum + x) + left + at * (right - left));
  }
}

template <class T>
void add_upsampled(const T* line, int64_t ratio, int64_t count, T* sum) {
  const auto all = std::make_integer_sequence<int, lanes<T>>{};
  if (ratio == 1) {
    for (int64_t x = 0; x < count; ++x) sum[x] += line[x];
  } else if (ratio >= lanes<T>) {
    add_upsampled<lanes<T>>(line, ratio, count, sum, all);
  } else if (ratio == 2) {
    add_upsampled<2>(line, ratio, count, sum, all);
  } else if (ratio == 4) {
    add_upsampled<4>(line, ratio, count, sum, all);
  } else {
    add_upsampled<8>(line, ratio, count, sum, all);
  }
}

/// Row y of a map, smoothed; `column` has room for two more elements than a row.
template <class T>
void smooth_row(const T* map, int64_t width, int64_t height, int64_t y, T side, T* __restrict column,
                T* __restrict line) {
  const T *upper = map + std::max<int64_t>(y - 1, 0) * width, *own = map + y * width,
          *lower = map + std::min(y + 1, height - 1) * width;
  const T middle = 1 - 2 * side;
  for (int64_t x = 0; x < width; ++x) column[x + 1] = middle * own[x] + side * (upper[x] + lower[x]);
  column[0] = column[1], column[width + 1] = column[width];
  for (int64_t x = 0; x < width; ++x) line[x] = middle * column[x + 1] + side * (column[x] + column[x + 2]);
}

}  // namespace

template <class T>
void upsample_sum(const UpsampleSum<T>& a, int threads) {
  threads = useful_threads(threads, a.count, a.out_height, a.out_width, 4);
  parallel_ranges(a.out_height, threads, [&](int64_t begin, int64_t end) {
    const int64_t widest = *std::max_element(a.width, a.width + a.count);
    const int64_t margin = std::min(*std::max_element(a.ratio, a.ratio + a.count) / 2, a.out_width);
    Scratch<T> line(widest + 2 * lanes<T>), column(widest + 2), sum(margin + a.out_width + lanes<T>);
    for (int64_t y = begin; y < end; ++y) {
      fill_zero<T>(sum, margin + a.out_width + lanes<T>);
      for (int i = 0; i < a.count; ++i) {
        const int64_t half = std::min(a.ratio[i] / 2, a.out_width), width = a.width[i];
        if (i == a.count - 1 && a.side > 0) {
          smooth_row<T>(a.map[i], width, a.height[i], y, a.side, column, line);
        } else {
          interpolate_rows<T>(a.map[i], width, a.height[i],
                              half_pixel_position<T>(y, static_cast<T>(a.ratio[i]), a.height[i]), 2 * lanes<T>, line);
        }
        for (int64_t x = 0; x < width + 2 * lanes<T>; ++x) line[x] *= a.gain[i];
        for (int64_t x = 0; x < half; ++x) sum[x] += line[0];
        add_upsampled<T>(line, a.ratio[i], a.out_width - half, sum + half);
      }
      std::copy_n(static_cast<const T*>(sum), a.out_width, a.out + y * a.out_width);
    }
  });
}

template <class T>
void upsample_concat(const UpsampleConcat<T>& a, int threads) {
  const int64_t channels = a.skip_channels + a.coarse_channels;
  threads = useful_threads(threads, a.batch, channels, a.height, a.width, 4);
  parallel_ranges(a.batch * channels * a.height, threads, [&](int64_t begin, int64_t end) {
    RowInterpolator<T> interpolator(a.width, a.coarse_width,
                                    [&](int64_t x) { return corner_position<T>(x, a.width, a.coarse_width); });
    for (int64_t i = begin; i < end; ++i) {
      const int64_t n = i / (channels * a.height), c = i / a.height % channels, y = i % a.height;
      const T scale = a.epilogue.scale[c], shift = a.epilogue.shift[c];
      T* __restrict out = a.out + i * a.width;
      const auto write = [=](int64_t x, T value) { out[x] = std::max(scale * value + shift, T(0)); };
      if (c < a.skip_channels) {
        const T* skip = a.skip + ((n * a.skip_channels + c) * a.height + y) * a.width;
        for (int64_t x = 0; x < a.width; ++x) write(x, skip[x]);
      } else {
        const int64_t plane = n * a.coarse_channels + c - a.skip_channels;
        interpolator.row(a.coarse + plane * a.coarse_height * a.coarse_width, a.coarse_height,
                         corner_position<T>(y, a.height, a.coarse_height), write);
      }
    }
  });
}

template <class T>
void upsample_add(const UpsampleAdd<T>& a, int threads) {
  const int64_t plane = a.coarse_height * a.coarse_width;
  threads = useful_threads(threads, a.batch, a.channels, a.depth, a.height, a.width, 4);
  parallel_ranges(a.batch * a.channels * a.depth * a.height, threads, [&](int64_t begin, int64_t end) {
    const auto position = [](int64_t i, int64_t size, int64_t coarse) {
      return half_pixel_position<T>(i, static_cast<T>(size) / static_cast<T>(coarse), coarse);
    };
    RowInterpolator<T> interpolator(a.width, a.coarse_width,
                                    [&](int64_t x) { return position(x, a.width, a.coarse_width); });
    const Scratch<T> near(a.coarse_width + 1), far(a.coarse_width + 1);
    for (int64_t i = begin; i < end; ++i) {
      const int64_t volume = i / a.height / a.depth;
      const LinearPosition<T> z = position(i / a.height % a.depth, a.depth, a.coarse_depth);
      const LinearPosition<T> y = position(i % a.height, a.height, a.coarse_height);
      const T* coarse = a.coarse + (volume * a.coarse_depth + z.low) * plane;
      interpolate_rows<T>(coarse, a.coarse_width, a.coarse_height, y, 1, near);
      interpolate_rows<T>(z.low + 1 < a.coarse_depth ? coarse + plane : coarse, a.coarse_width, a.coarse_height, y, 1,
                          far);
      T* __restrict line = near;
      const T* __restrict other = far;
      for (int64_t x = 0; x <= a.coarse_width; ++x) line[x] += z.fraction * (other[x] - line[x]);
      const T scale = a.epilogue.scale[volume % a.channels], shift = a.epilogue.shift[volume % a.channels];
      const T* __restrict input = a.input + i * a.width;
      T* __restrict out = a.out + i * a.width;
      interpolator.row(line, [=](int64_t x, T value) { out[x] = std::max(scale * (input[x] + value) + shift, T(0)); });
    }
  });
}

template void upsample_sum<float>(const UpsampleSum<float>&, int);
template void upsample_concat<float>(const UpsampleConcat<float>&, int);
template void upsample_add<float>(const UpsampleAdd<float>&, int);

}  // namespace anynet::ANYNET_ISA
