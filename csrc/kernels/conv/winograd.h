// Winograd's algorithm F(2x2, 3x3) (Lavin and Gray, arXiv 1509.09308): the 2 x 2 outputs of a tile take 4 x 4 products
// of transformed pixels with transformed weights instead of 4 x 9. In three dimensions it goes over depth and height;
// along the width the kernel slides as it does in `direct.h`, so that a pixel's neighbours never change lanes. In two
// it goes over height and width, and a vector of tiles is two of columns, the even and the odd ones.
//
// The transforms cost additions per channel, so this pays where channels are many. It rounds differently from the
// direct kernel (by a few units in the last place), and a NaN or infinity spreads over its whole tile.
#pragma once

#include <limits>
#include <type_traits>

#include "../common/scratch.h"
#include "direct.h"

namespace anynet::ANYNET_ISA {
namespace {

constexpr int positions = 16;  // of a tile: 4 z + y or, flat, 4 y + x

/// What differs between convolutions in three dimensions and flat ones.
template <class T, bool flat>
struct Tiling {
  static constexpr int taps = flat ? 1 : 3;                  // columns that a product slides over
  static constexpr int rows = flat ? 4 : positions;          // that a tile reads
  static constexpr int columns = (flat ? 2 : 1) * lanes<T>;  // outputs of a vector of tiles, side by side

  static int64_t vectors(int64_t width) { return (width + columns - 1) / columns; }
  /// The last vector of a row ends where the row ends.
  static int64_t start(int64_t vector, int64_t width) { return std::min(vector * columns, width - columns); }
  /// Where the scratch rows have what belongs to column start(vector, width): flat ones have no neighbours.
  static int64_t slot(int64_t vector, int64_t width) { return flat ? vector * lanes<T> : start(vector, width); }

  /// Whether it computes this convolution, and faster: what is saved goes with the product of the channels, the cost of
  /// the transforms with their sum.
  static bool pays(const Geometry& g) {
    const int64_t C = g.in_channels, O = g.out_channels;
    const bool many = flat ? C * O > 6 * (C + O) : std::min(C, O) >= 8;
    return std::is_same_v<T, float> && g.kernel_depth == (flat ? 1 : 3) && g.stride == 1 && g.dilation == 1 && many &&
           g.out_width >= columns && g.out_height > 1 && (flat || g.out_depth > 1);
  }
};

/// Four values of the input, `step` apart, transformed in place.
template <class T>
ANYNET_INLINE void transform_input(vec<T>* d, int step) {
  const vec<T> first = d[0] - d[2 * step], sum = d[step] + d[2 * step];
  const vec<T> difference = d[2 * step] - d[step], last = d[step] - d[3 * step];
  d[0] = first, d[step] = sum, d[2 * step] = difference, d[3 * step] = last;
}

/// Three weights `step` apart to four, `to_step` apart.
template <class T>
void transform_weights(const T* g, int step, T* to, int to_step) {
  const T outer = g[0] + g[2 * step];
  to[0] = g[0];
  to[to_step] = (outer + g[step]) / 2;
  to[2 * to_step] = (outer - g[step]) / 2;
  to[3 * to_step] = g[2 * step];
}

/// Four sums of products `step` apart to two outputs, the first two of them.
template <class T>
ANYNET_INLINE void transform_output(vec<T>* m, int step) {
  const vec<T> first = m[0] + m[step] + m[2 * step], second = m[step] - m[2 * step] - m[3 * step];
  m[0] = first, m[step] = second;
}

/// [position][block of output channels][in_channels][tap][channel of the block], from weight(o, c, tap and kx).
template <class T, bool flat, class Weight>
Vector<T> pack_transformed(const Geometry& g, const Weight& weight) {
  constexpr int taps = Tiling<T, flat>::taps;
  const int64_t size_of_channel = g.in_channels * taps, position = g.out_channels * size_of_channel;
  Vector<T> packed(positions * position);
  for (int64_t o = 0, size; o < g.out_channels; o += size) {
    size = block_at(o, g.out_channels, max_channels);
    for (int64_t c = 0; c < g.in_channels; ++c) {
      for (int64_t k = 0; k < taps; ++k) {
        for (int64_t i = 0; i < size; ++i) {
          T rows[3 * 4], all[4 * 4];  // transformed over the inner of the two dimensions, then over the outer one
          for (int outer = 0; outer < 3; ++outer) {
            T inner[3];
            for (int t = 0; t < 3; ++t) inner[t] = weight(o + i, c, (outer * 3 + t) * taps + k);
            transform_weights(inner, 1, rows + 4 * outer, 1);
          }
          for (int t = 0; t < 4; ++t) transform_weights(rows + t, 4, all + t, 4);
          T* to = packed.data() + o * size_of_channel + (c * taps + k) * size + i;
          for (int p = 0; p < positions; ++p) to[p * position] = all[p];
        }
      }
    }
  }
  return packed;
}

/// Every second element of two vectors, from the first or from the second one on.
template <class T, int odd, int... I>
ANYNET_INLINE vec<T> every_second(vec<T> a, vec<T> b, std::integer_sequence<int, I...>) {
  return __builtin_shufflevector(a, b, (2 * I + odd)...);
}
/// The elements of two vectors in turn: of their first or of their second halves.
template <class T, int half, int... I>
ANYNET_INLINE vec<T> in_turn(vec<T> a, vec<T> b, std::integer_sequence<int, I...>) {
  return __builtin_shufflevector(a, b, (half * lanes<T> / 2 + I / 2 + I % 2 * lanes<T>)...);
}

/// The 4 x 4 pixels of a vector of tiles, `x` columns to the right of `rows`. left, right: the first column, or the
/// last, lies outside the image, and is 0.
template <class T, bool flat>
ANYNET_INLINE void load_tiles(const T* const* rows, int64_t x, bool left, bool right, vec<T>* d) {
  constexpr int L = lanes<T>;
  if constexpr (flat) {
    const LaneRange<T> first(left ? 1 : 0, L), last(0, right ? L - 1 : L);
#pragma GCC unroll 4
    for (int y = 0; y < 4; ++y) {
      const T* row = rows[y] + x;
      const vec<T> a = load(row, first), b = load(row + L), c = load(row + 2), e = load(row + 2 + L, last);
      d[4 * y] = every_second<T, 0>(a, b, lane_sequence<T>{}),
            d[4 * y + 1] = every_second<T, 1>(a, b, lane_sequence<T>{});
      d[4 * y + 2] = every_second<T, 0>(c, e, lane_sequence<T>{});
      d[4 * y + 3] = every_second<T, 1>(c, e, lane_sequence<T>{});
    }
  } else {
    const LaneRange<T> inside(left ? 1 : 0, right ? L - 1 : L);
#pragma GCC unroll 16
    for (int p = 0; p < positions; ++p) d[p] = load(rows[p] + x, inside);
  }
}

/// `count` columns of a channel's rows, transformed, to rows `step` apart. left, right: see `load_tiles`. `ahead`: how
/// much further on the rows will be read next.
template <class T, bool flat>
ANYNET_INLINE void transform_strip(const T* const* rows, int64_t count, bool left, bool right, int64_t ahead, T* to,
                                   int64_t step) {
  using Tiles = Tiling<T, flat>;
  const int64_t vectors = Tiles::vectors(count);
  for (int64_t v = 0; v < vectors; ++v) {
    const int64_t x = Tiles::start(v, count), slot = Tiles::slot(v, count);
    vec<T> d[positions];
    load_tiles<T, flat>(rows, x, left && v == 0, right && v == vectors - 1, d);
#pragma GCC unroll 16
    for (int r = 0; r < Tiles::rows; ++r) __builtin_prefetch(rows[r] + x + ahead);
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) transform_input<T>(d + 4 * i, 1);
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) transform_input<T>(d + i, 4);
#pragma GCC unroll 16
    for (int p = 0; p < positions; ++p) store(to + p * step + slot, d[p]);
  }
}

/// The products of one position: CO output channels x V vectors of `in`, the transformed rows of all input channels,
/// `pitch` apart.
template <class T, int taps, int CO, int V>
void multiply(const T* in, int64_t pitch, int64_t channels, const T* weight, T* out) {
  constexpr int L = lanes<T>;
  vec<T> sum[CO][V] = {};
  for (int64_t c = 0; c < channels; ++c, in += pitch) {
#pragma GCC unroll 3
    for (int k = 0; k < taps; ++k, weight += CO) {
      vec<T> pixels[V];
#pragma GCC unroll 8
      for (int v = 0; v < V; ++v) pixels[v] = load(in + k + v * L);
#pragma GCC unroll 8
      for (int o = 0; o < CO; ++o) {
        const vec<T> wo = splat(weight[o]);
#pragma GCC unroll 8
        for (int v = 0; v < V; ++v) sum[o][v] += wo * pixels[v];
        read_after(weight, sum[o][V - 1]);
      }
    }
  }
#pragma GCC unroll 8
  for (int o = 0; o < CO; ++o) {
#pragma GCC unroll 8
    for (int v = 0; v < V; ++v) store(out + (o * V + v) * L, sum[o][v]);
  }
}

template <class T>
using Multiply = void (*)(const T*, int64_t, int64_t, const T*, T*);

template <class T, int taps, int CO, int... V>
Multiply<T> pick_multiply(int64_t vectors, std::integer_sequence<int, V...>) {
  static constexpr Multiply<T> all[] = {multiply<T, taps, CO, V + 1>...};
  return all[vectors - 1];
}
constexpr int strip_vectors = vectors_beside(max_channels);
template <class T, int taps>
Multiply<T> pick_multiply(int64_t channels, int64_t vectors) {
  constexpr auto most = std::make_integer_sequence<int, strip_vectors>{};
  if constexpr (max_channels >= 8) {
    if (channels == 8) return pick_multiply<T, taps, 8>(vectors, most);
  }
  return channels == 1   ? pick_multiply<T, taps, 1>(vectors, most)
         : channels == 2 ? pick_multiply<T, taps, 2>(vectors, most)
                         : pick_multiply<T, taps, 4>(vectors, most);
}

/// `count` columns of a tile's output rows of one channel, from the products of all positions, `step` apart. at: where
/// the four vectors of outputs begin in `out` and `positive`; -1: outside the image.
template <class T, bool flat>
ANYNET_INLINE void finish_strip(const T* products, int64_t step, int64_t count, T bias, bool relu, const T* positive,
                                T* out, const int64_t* at) {
  using Tiles = Tiling<T, flat>;
  const int64_t vectors = Tiles::vectors(count);
  const vec<T> lowest = splat(relu ? T(0) : -std::numeric_limits<T>::infinity());
  for (int64_t v = 0; v < vectors; ++v) {
    const int64_t x = Tiles::start(v, count), slot = Tiles::slot(v, count);
    vec<T> m[positions];
#pragma GCC unroll 16
    for (int p = 0; p < positions; ++p) m[p] = load(products + p * step + slot);
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) transform_output<T>(m + 4 * i, 1);
    transform_output<T>(m, 4);
    transform_output<T>(m + 1, 4);
    if constexpr (flat) {
#pragma GCC unroll 2
      for (int y = 0; y < 2; ++y) {
        const vec<T> even = m[4 * y], odd = m[4 * y + 1];
        m[4 * y] = in_turn<T, 0>(even, odd, lane_sequence<T>{});
        m[4 * y + 1] = in_turn<T, 1>(even, odd, lane_sequence<T>{});
      }
    }
#pragma GCC unroll 4
    for (int k = 0; k < 4; ++k) {
      if (at[k] < 0) continue;
      vec<T> value = m[k / 2 * 4 + k % 2] + bias;
      value = value < lowest ? lowest : value;  // keeps NaN
      if (positive != nullptr) value = load(positive + at[k] + x) > vec<T>{} ? value : vec<T>{};
      store(out + at[k] + x, value);
    }
  }
}

/// `convolve` by tiles, with weights from pack_transformed. A tile goes in strips of columns, so that the transformed
/// rows and the products stay in the nearest caches.
template <class T, bool flat>
void convolve_tiles(const Geometry& g, const Source<T>& source, const Vector<T>& weights, const T* bias, bool relu,
                    const T* positive, T* out, int threads) {
  using Tiles = Tiling<T, flat>;
  constexpr int L = lanes<T>, most = strip_vectors, taps = Tiles::taps;
  constexpr int64_t pitch = (most + 1) * L;  // of a transformed row
  const int64_t W = g.out_width, C = g.in_channels, O = g.out_channels, vectors = Tiles::vectors(W);
  const int64_t strips = (vectors + most - 1) / most, layers = flat ? 1 : 2;  // of a tile's outputs
  const int64_t tiles_y = (g.out_height + 1) / 2, tiles_z = (g.out_depth + layers - 1) / layers;
  const int64_t tiles = tiles_z * tiles_y, channel = g.in_rows() * source.pitch, plane = g.out_rows() * W;
  const int64_t position = C * pitch + L;  // a power of two would put all positions into the same few cache lines
  parallel_ranges(g.batch * tiles, threads, [&](int64_t begin, int64_t end) {
    const Scratch<T> input(positions * position), products(positions * max_channels * most * L), zeros(W + 2);
    fill_zero<T>(zeros, W + 2);
    fill_zero<T>(input, positions * position);
    for (int64_t unit = begin; unit < end; ++unit) {
      const int64_t y = unit % tiles_y * 2, z = unit / tiles_y % tiles_z * layers, n = unit / tiles;
      const T* rows[Tiles::rows];  // of the first channel, from column -1 on
      int64_t to_channel[Tiles::rows];
      for (int r = 0; r < Tiles::rows; ++r) {
        const int64_t iz = flat ? z : z + r / 4 - 1, iy = y + r % 4 - 1;
        const bool inside = iz >= 0 && iz < g.in_depth && iy >= 0 && iy < g.in_height;
        const T* row = source.data + n * C * channel + (iz * g.in_height + iy) * source.pitch + source.column[0];
        rows[r] = inside ? row : zeros;
        to_channel[r] = inside ? channel : 0;
      }
      for (int64_t strip = 0; strip < strips; ++strip) {
        const int64_t first = vectors * strip / strips, next = vectors * (strip + 1) / strips;
        const int64_t x = first * Tiles::columns, count = std::min(next * Tiles::columns, W) - x,
                      row = (next - first) * L;
        const bool left = !source.padded && x == 0, right = !source.padded && x + count == W;
        const int64_t ahead = x + count < W ? count : 2 * source.pitch - x;
        const T* from[Tiles::rows];
        for (int r = 0; r < Tiles::rows; ++r) from[r] = rows[r] + x;
        for (int64_t c = 0; c < C; ++c) {
          // What slides needs two columns more.
          transform_strip<T, flat>(from, count + taps - 1, left, right, ahead, input + c * pitch, position);
          for (int r = 0; r < Tiles::rows; ++r) from[r] += to_channel[r];
        }
        int64_t at[4];
        for (int k = 0; k < 4; ++k) {
          const int64_t oz = flat ? z : z + k / 2, oy = y + (flat ? k / 2 : k % 2);
          const int64_t column = x + (flat ? k % 2 * L : 0);
          at[k] = oz < g.out_depth && oy < g.out_height ? (oz * g.out_height + oy) * W + column : -1;
        }
        for (int64_t o = 0, size; o < O; o += size) {
          size = block_at(o, O, max_channels);
          const auto function = pick_multiply<T, taps>(size, next - first);
          for (int p = 0; p < positions; ++p) {
            function(input + p * position, pitch, C, weights.data() + (p * O + o) * C * taps,
                     products + p * size * row);
          }
          for (int64_t i = 0; i < size; ++i) {
            const int64_t to = (n * O + o + i) * plane;
            finish_strip<T, flat>(products + i * row, size * row, count, bias == nullptr ? T(0) : bias[o + i], relu,
                                  positive == nullptr ? nullptr : positive + to, out + to, at);
          }
        }
      }
    }
  });
}

}  // namespace
}  // namespace anynet::ANYNET_ISA
