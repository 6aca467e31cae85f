#include <algorithm>
#include <limits>
#include <utility>

#include "../common/exp.h"
#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "inference.h"

namespace anynet::ANYNET_ISA {
namespace {

/// A position on an axis of `size` elements: between `low` and `low + 1`, at `fraction`. An axis of one element is
/// read as two equal ones.
template <class T>
struct Position {
  int64_t low;
  T fraction;

  Position(T p, int64_t size) : low(static_cast<int64_t>(std::max(p, T(0)))) {
    low = std::min(low, std::max<int64_t>(size - 2, 0));
    fraction = std::min(std::max(p - static_cast<T>(low), T(0)), T(1));
  }
};

/// Pixels as areas: element i of an axis that is `ratio` times longer.
template <class T>
Position<T> area_position(int64_t i, T ratio, int64_t size) {
  return {(static_cast<T>(i) + T(0.5)) / ratio - T(0.5), size};
}

/// The line between two rows of a map, and one more element, or a vector more: the last one again.
template <class T>
void blend_rows(const T* map, int64_t width, int64_t height, const Position<T>& y, int64_t more, T* __restrict line) {
  const T* upper = map + y.low * width;
  const T* lower = y.low + 1 < height ? upper + width : upper;
  for (int64_t x = 0; x < width; ++x) line[x] = upper[x] + y.fraction * (lower[x] - upper[x]);
  for (int64_t x = width; x < width + more; ++x) line[x] = line[width - 1];
}

/// sum[x] += the line, enlarged `ratio` times, at x - ratio / 2, pixels being areas: then output pixels 0 to ratio - 1
/// lie between elements 0 and 1, at (k + 1/2) / ratio, and so on. `ratio` is `Ratio`, or a vector's lanes or more.
template <int Ratio, class T, int... I>
void add_enlarged(const T* line, int64_t ratio, int64_t count, T* __restrict sum, std::integer_sequence<int, I...>) {
  const T each = T(1) / static_cast<T>(ratio);
  const vec<T> fraction = {(static_cast<T>(I % Ratio) + T(0.5)) * each...};
  for (int64_t x = 0; x < count; x += lanes<T>) {
    const T* from = line + x / ratio;
    vec<T> left, right, at = fraction;
    if constexpr (Ratio < lanes<T>) {
      const vec<T> both = load(from), next = load(from + 1);
      left = __builtin_shufflevector(both, both, (I / Ratio)...);
      right = __builtin_shufflevector(next, next, (I / Ratio)...);
    } else {
      left = splat(from[0]), right = splat(from[1]);
      at += static_cast<T>(x % ratio) * each;
    }
    store(sum + x, load(sum + x) + left + at * (right - left));
  }
}

template <class T>
void add_enlarged(const T* line, int64_t ratio, int64_t count, T* sum) {
  const auto all = std::make_integer_sequence<int, lanes<T>>{};
  if (ratio == 1) {
    for (int64_t x = 0; x < count; ++x) sum[x] += line[x];
  } else if (ratio >= lanes<T>) {
    add_enlarged<lanes<T>>(line, ratio, count, sum, all);
  } else if (ratio == 2) {
    add_enlarged<2>(line, ratio, count, sum, all);
  } else if (ratio == 4) {
    add_enlarged<4>(line, ratio, count, sum, all);
  } else {
    add_enlarged<8>(line, ratio, count, sum, all);
  }
}

/// Pixels as points: element i of an axis of `out_size`.
template <class T>
Position<T> point_position(int64_t i, int64_t out_size, int64_t size) {
  return {out_size > 1 ? static_cast<T>(i * (size - 1)) / static_cast<T>(out_size - 1) : T(0), size};
}

/// The columns that a row is enlarged to, and a row between two rows of the source.
template <class T>
class Enlarger {
 public:
  template <class F>
  Enlarger(int64_t out_width, int64_t width, const F& position)
      : out_width_(out_width), width_(width), low_(out_width), fraction_(out_width), line_(width + 1) {
    for (int64_t x = 0; x < out_width; ++x) {
      const Position<T> p = position(x);
      low_[x] = static_cast<int32_t>(p.low);
      fraction_[x] = p.fraction;
    }
  }

  /// write(x, value) for each column x of the row at `y` of `map`.
  template <class F>
  void row(const T* map, int64_t height, const Position<T>& y, const F& write) {
    blend_rows<T>(map, width_, height, y, 1, line_);
    row(line_, write);
  }

  /// The same for a row that is there, with its last element once more.
  template <class F>
  void row(const T* __restrict line, const F& write) {
    const int32_t* __restrict low = low_;
    const T* __restrict fraction = fraction_;
#pragma omp simd
    for (int64_t x = 0; x < out_width_; ++x) {
      const T left = line[low[x]];
      write(x, left + fraction[x] * (line[low[x] + 1] - left));
    }
  }

 private:
  int64_t out_width_, width_;
  Scratch<int32_t> low_;
  Scratch<T> fraction_, line_;
};

}  // namespace

template <class T>
void upsample_sum(const UpsampleSum<T>& a, int threads) {
  threads = useful_threads(a.count * a.out_height * a.out_width * 4, threads);
  parallel_ranges(a.out_height, threads, [&](int64_t begin, int64_t end) {
    const int64_t widest = *std::max_element(a.width, a.width + a.count);
    const int64_t margin = *std::max_element(a.ratio, a.ratio + a.count) / 2;
    Scratch<T> line(widest + 2 * lanes<T>), sum(margin + a.out_width + lanes<T>);
    for (int64_t y = begin; y < end; ++y) {
      fill_zero<T>(sum, margin + a.out_width + lanes<T>);
      for (int i = 0; i < a.count; ++i) {
        const int64_t half = a.ratio[i] / 2;
        blend_rows<T>(a.map[i], a.width[i], a.height[i], area_position<T>(y, static_cast<T>(a.ratio[i]), a.height[i]),
                      2 * lanes<T>, line);
        for (int64_t x = 0; x < std::min(half, a.out_width); ++x) sum[x] += line[0];
        add_enlarged<T>(line, a.ratio[i], a.out_width - half, sum + half);
      }
      T* __restrict out = a.out + y * a.out_width;
      const T* __restrict from = sum;
      for (int64_t x = 0; x < a.out_width; ++x) out[x] = a.gain * from[x];
    }
  });
}

template <class T>
void upsample_concat(const UpsampleConcat<T>& a, int threads) {
  const int64_t channels = a.skip_channels + a.coarse_channels, pixels = a.height * a.width;
  threads = useful_threads(a.batch * channels * pixels * 4, threads);
  parallel_ranges(a.batch * channels * a.height, threads, [&](int64_t begin, int64_t end) {
    Enlarger<T> enlarger(a.width, a.coarse_width,
                         [&](int64_t x) { return point_position<T>(x, a.width, a.coarse_width); });
    for (int64_t i = begin; i < end; ++i) {
      const int64_t n = i / (channels * a.height), c = i / a.height % channels, y = i % a.height;
      const T scale = a.scale[c], shift = a.shift[c];
      T* __restrict out = a.out + i * a.width;
      const auto write = [=](int64_t x, T value) { out[x] = std::max(scale * value + shift, T(0)); };
      if (c < a.skip_channels) {
        const T* skip = a.skip + ((n * a.skip_channels + c) * a.height + y) * a.width;
        for (int64_t x = 0; x < a.width; ++x) write(x, skip[x]);
      } else {
        const int64_t plane = n * a.coarse_channels + c - a.skip_channels;
        enlarger.row(a.coarse + plane * a.coarse_height * a.coarse_width, a.coarse_height,
                     point_position<T>(y, a.height, a.coarse_height), write);
      }
    }
  });
}

template <class T>
void upsample_add(const UpsampleAdd<T>& a, int threads) {
  const int64_t plane = a.coarse_height * a.coarse_width;
  threads = useful_threads(a.batch * a.channels * a.depth * a.height * a.width * 4, threads);
  parallel_ranges(a.batch * a.channels * a.depth * a.height, threads, [&](int64_t begin, int64_t end) {
    const auto position = [](int64_t i, int64_t size, int64_t coarse) {
      return area_position<T>(i, static_cast<T>(size) / static_cast<T>(coarse), coarse);
    };
    Enlarger<T> enlarger(a.width, a.coarse_width, [&](int64_t x) { return position(x, a.width, a.coarse_width); });
    const Scratch<T> near(a.coarse_width + 1), far(a.coarse_width + 1);
    for (int64_t i = begin; i < end; ++i) {
      const int64_t volume = i / a.height / a.depth;
      const Position<T> z = position(i / a.height % a.depth, a.depth, a.coarse_depth);
      const Position<T> y = position(i % a.height, a.height, a.coarse_height);
      const T* coarse = a.coarse + (volume * a.coarse_depth + z.low) * plane;
      blend_rows<T>(coarse, a.coarse_width, a.coarse_height, y, 1, near);
      blend_rows<T>(z.low + 1 < a.coarse_depth ? coarse + plane : coarse, a.coarse_width, a.coarse_height, y, 1, far);
      T* __restrict line = near;
      const T* __restrict other = far;
      for (int64_t x = 0; x <= a.coarse_width; ++x) line[x] += z.fraction * (other[x] - line[x]);
      const T scale = a.scale[volume % a.channels], shift = a.shift[volume % a.channels];
      const T* __restrict input = a.input + i * a.width;
      T* __restrict out = a.out + i * a.width;
      enlarger.row(line, [=](int64_t x, T value) { out[x] = std::max(scale * (input[x] + value) + shift, T(0)); });
    }
  });
}

template <class T>
void max_pool(const MaxPool<T>& a, int threads) {
  const int64_t height = a.height / 2, width = a.width / 2;
  threads = useful_threads(a.batch * a.channels * height * width * 4, threads);
  parallel_for(a.batch * a.channels * height, threads, [&](int64_t i) {
    const int64_t plane = i / height, y = i % height;
    const T* upper = a.in + (plane * a.height + 2 * y) * a.width;
    const T* lower = upper + a.width;
    const T scale = a.scale[plane % a.channels], shift = a.shift[plane % a.channels];
    T* __restrict out = a.out + i * width;
    for (int64_t x = 0; x < width; ++x) {
      const T largest = std::max(std::max(upper[2 * x], upper[2 * x + 1]), std::max(lower[2 * x], lower[2 * x + 1]));
      out[x] = std::max(scale * largest + shift, T(0));
    }
  });
}

template <class T>
void fill_occlusions(const FillOcclusions<T>& a, int threads) {
  const auto clamped = [](T x) { return std::min(std::max(x, T(0)), T(1)); };
  const auto blend = [](T own, T neighbour, T gate) { return (T(1) - gate) * own + gate * neighbour; };
  parallel_ranges(a.rows, useful_threads(a.rows * a.width * 8, threads), [&](int64_t begin, int64_t end) {
    const Scratch<T> behind(a.width);
    for (int64_t y = begin; y < end; ++y) {
      const T* disparity = a.disparity + y * a.width;
      T* out = a.out + y * a.width;
      T leftmost = std::numeric_limits<T>::infinity(), neighbour = disparity[a.width - 1];
      for (int64_t x = a.width - 1; x >= 0; --x) {
        const T lands = static_cast<T>(x) - disparity[x] / a.pixel;
        leftmost = std::min(leftmost, lands);
        const T outside = clamped(T(-0.5) * lands);
        behind[x] = clamped(T(0.5) * (lands - leftmost - T(0.5))) * (T(1) - outside);
        out[x] = neighbour = blend(disparity[x], neighbour, outside);
      }
      for (int64_t x = 1; x < a.width; ++x) out[x] = neighbour = blend(out[x], neighbour, behind[x]);
    }
  });
}

template <class T>
void window_extremes(const WindowExtremes<T>& a, int threads) {
  const int64_t r = a.radius, padded = a.width + 2 * r, pixels = a.height * a.width;
  parallel_ranges(a.height, useful_threads(pixels * r * 8, threads), [&](int64_t begin, int64_t end) {
    const Scratch<T> columns(padded);
    for (int64_t y = begin; y < end; ++y) {
      const int64_t top = std::max<int64_t>(y - r, 0), bottom = std::min(y + r, a.height - 1);
      const auto along = [&](auto better, T* out) {
        std::copy_n(a.in + top * a.width, a.width, columns + r);
        for (int64_t j = top + 1; j <= bottom; ++j) {
          const T* row = a.in + j * a.width;
          for (int64_t x = 0; x < a.width; ++x) columns[r + x] = better(columns[r + x], row[x]);
        }
        // The border's columns once more change no extreme.
        for (int64_t x = 0; x < r; ++x) columns[x] = columns[r];
        for (int64_t x = r + a.width; x < padded; ++x) columns[x] = columns[r + a.width - 1];
        for (int64_t x = 0; x < a.width; ++x) {
          T best = columns[x];
          for (int64_t i = 1; i <= 2 * r; ++i) best = better(best, columns[x + i]);
          out[x] = best;
        }
      };
      T* out = a.out + y * a.width;
      along([](T p, T q) { return p < q ? q : p; }, out);
      along([](T p, T q) { return q < p ? q : p; }, out + pixels);
    }
  });
}

template <class T>
void candidate_costs(const CandidateCosts<T>& a, int threads) {
  parallel_ranges(a.pixels, useful_threads(a.pixels * a.channels, threads), [&](int64_t begin, int64_t end) {
    for (int64_t c = 0; c < a.channels; ++c) {
      std::copy(a.features + c * a.pixels + begin, a.features + c * a.pixels + end, a.copy + c * a.pixels + begin);
    }
    for (int64_t c = 0; c < 2; ++c) {
      T* __restrict offsets = a.offsets + c * a.pixels;
      for (int64_t i = begin; i < end; ++i) offsets[i] -= a.disparity[i];
    }
  });
}

template <class T>
void expected_disparity(const ExpectedDisparity<T>& a, int threads) {
  const int64_t vectors = (a.pixels + lanes<T> - 1) / lanes<T>;
  parallel_ranges(vectors, useful_threads(a.pixels * a.count * 8, threads), [&](int64_t begin, int64_t end) {
    for (int64_t v = begin; v < end; ++v) {
      const int64_t i = v * lanes<T>, n = std::min<int64_t>(a.pixels - i, lanes<T>);
      const auto read = [&](const T* plane) { return n == lanes<T> ? load(plane + i) : read_vector(plane + i, 1, n); };
      vec<T> least = read(a.cost);
      for (int64_t k = 1; k < a.count; ++k) least = smaller<T>(least, read(a.cost + k * a.pixels));
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

template <class T>
void convex_upsampling(const ConvexUpsampling<T>& a, int threads) {
  // Whole vectors and a column on either side, so that the last vector of a row needs no case of its own.
  const int64_t padded = round_up(a.width, lanes<T>) + 2, plane = a.height * a.width;
  const int64_t rows = a.batch * a.height;
  parallel_ranges(rows, useful_threads(rows * a.width * 256, threads), [&](int64_t begin, int64_t end) {
    const Scratch<T> around(3 * padded), even(padded), odd(padded);
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / a.height, y = task % a.height;
      for (int64_t i = 0; i < 3; ++i) {
        const T* row = a.in + n * plane + std::clamp<int64_t>(y + i - 1, 0, a.height - 1) * a.width;
        T* line = around + i * padded;
        line[0] = row[0];
        std::copy_n(row, a.width, line + 1);
        std::fill(line + 1 + a.width, line + padded, row[a.width - 1]);
      }
      const T* logits = a.logits + n * 32 * plane + y * a.width;
      const auto enlarge = [&](const T* logits, T* line) {
        for (int64_t x = 0; x < a.width; x += lanes<T>) {
          vec<T> logit[8], most{};
          for (int k = 0; k < 8; ++k) {
            logit[k] = read_vector(logits + k * plane + x, 1, std::min<int64_t>(a.width - x, lanes<T>));
            most = larger<T>(most, logit[k]);
          }
          vec<T> sum = exp_nonpositive<T>(-most), value = sum * load(around + padded + x + 1);
          for (int k = 0; k < 8; ++k) {
            const int i = k < 4 ? k : k + 1;
            const vec<T> weight = exp_nonpositive<T>(logit[k] - most);
            sum += weight;
            value += weight * load(around + i / 3 * padded + i % 3 + x);
          }
          store(line + x, value / sum);
        }
      };
      for (int64_t i = 0; i < 2; ++i) {
        enlarge(logits + 16 * i * plane, even);
        enlarge(logits + (16 * i + 8) * plane, odd);
        T* __restrict out = a.out + (task * 2 + i) * 2 * a.width;
        const T* __restrict left = even, * __restrict right = odd;
        for (int64_t x = 0; x < a.width; ++x) {
          out[2 * x] = left[x];
          out[2 * x + 1] = right[x];
        }
      }
    }
  });
}

template <class T>
void read_image(const ReadImage<T>& a, int threads) {
  const int64_t first = std::max<int64_t>(a.factor / 2 - 1, 0), second = a.factor / 2;
  const T gain[3] = {T(0.25) / a.std[0], T(0.25) / a.std[1], T(0.25) / a.std[2]};
  const int64_t plane = a.height * a.width, rows = a.block * a.height;
  parallel_for(rows, useful_threads(rows * a.block * a.width * 16, threads), [&](int64_t row) {
    const auto line = [&](int64_t y) { return a.image + std::min(y, a.image_height - 1) * a.image_width * 3; };
    const auto column = [&](int64_t x) { return 3 * std::min(x, a.image_width - 1); };
    const uint8_t *upper = line(a.factor * row + first), *lower = line(a.factor * row + second);
    for (int64_t j = 0; j < a.block; ++j) {
      T* out = a.out + (row % a.block * a.block + j) * plane + row / a.block * a.width;
      for (int64_t x = 0; x < a.width; ++x) {
        const int64_t from = a.factor * (a.block * x + j), left = column(from + first), right = column(from + second);
        for (int c = 0; c < 3; ++c) {
          const int32_t sum = upper[left + c] + upper[right + c] + lower[left + c] + lower[right + c];
          out[c * a.block * a.block * plane + x] = (static_cast<T>(sum) - 4 * a.mean[c]) * gain[c];
        }
      }
    }
  });
}

template void upsample_sum<float>(const UpsampleSum<float>&, int);
template void upsample_concat<float>(const UpsampleConcat<float>&, int);
template void upsample_add<float>(const UpsampleAdd<float>&, int);
template void max_pool<float>(const MaxPool<float>&, int);
template void fill_occlusions<float>(const FillOcclusions<float>&, int);
template void window_extremes<float>(const WindowExtremes<float>&, int);
template void candidate_costs<float>(const CandidateCosts<float>&, int);
template void expected_disparity<float>(const ExpectedDisparity<float>&, int);
template void convex_upsampling<float>(const ConvexUpsampling<float>&, int);
template void read_image<float>(const ReadImage<float>&, int);

}  // namespace anynet::ANYNET_ISA
