// Winograd's algorithm F(2x2, 3x3) over depth and height (Lavin and Gray, arXiv 1509.09308): the 2 x 2 outputs of a
// tile take 4 x 4 products of transformed rows with transformed weights instead of 4 x 9. Along the width the kernel
// slides as it does in `direct.h`, so that a pixel's neighbours never change lanes.
//
// The transforms cost additions per channel, so this pays where channels are many; over the height alone, as 2-D
// convolutions would have it, it does not. It rounds differently from the direct kernel (by a few units in the last
// place), and a NaN or infinity spreads over its whole tile.
#pragma once

#include <limits>
#include <type_traits>

#include "../common/scratch.h"
#include "direct.h"

namespace anynet::ANYNET_ISA {
namespace {

constexpr int positions = 16;  // of a tile: 4 z + y

/// Whether it computes this convolution, and faster.
template <class T>
bool winograd_pays(const Geometry& g) {
  return std::is_same_v<T, float> && g.kernel_depth == 3 && g.stride == 1 && g.dilation == 1 &&
         std::min(g.in_channels, g.out_channels) >= 8 && g.out_width >= lanes<T> && g.out_height > 1 && g.out_depth > 1;
}

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

/// [position][block of output channels][in_channels][kx][channel of the block], from weight(o, c, tap and kx).
template <class T, class Weight>
Vector<T> pack_transformed(const Geometry& g, const Weight& weight) {
  const int64_t size_of_channel = g.in_channels * 3, position = g.out_channels * size_of_channel;
  Vector<T> packed(positions * position);
  for (int64_t o = 0, size; o < g.out_channels; o += size) {
    size = block_at(o, g.out_channels, max_channels);
    for (int64_t c = 0; c < g.in_channels; ++c) {
      for (int64_t kx = 0; kx < 3; ++kx) {
        for (int64_t i = 0; i < size; ++i) {
          T rows[3 * 4], all[4 * 4];  // transformed over height, then over depth
          for (int kz = 0; kz < 3; ++kz) {
            T taps[3];
            for (int ky = 0; ky < 3; ++ky) taps[ky] = weight(o + i, c, (kz * 3 + ky) * 3 + kx);
            transform_weights(taps, 1, rows + 4 * kz, 1);
          }
          for (int y = 0; y < 4; ++y) transform_weights(rows + y, 4, all + y, 4);
          T* to = packed.data() + o * size_of_channel + (c * 3 + kx) * size + i;
          for (int p = 0; p < positions; ++p) to[p * position] = all[p];
        }
      }
    }
  }
  return packed;
}

/// `count` columns of a channel's 4 x 4 rows, transformed, to rows `step` apart. left, right: the first column, or the
/// last, lies outside the image, and is 0. `ahead`: how much further on the rows will be read next.
template <class T>
ANYNET_INLINE void transform_strip(const T* const* rows, int64_t count, bool left, bool right, int64_t ahead, T* to,
                                   int64_t step) {
  constexpr int L = lanes<T>;
  const int64_t vectors = vectors_in<T>(count);
  for (int64_t v = 0; v < vectors; ++v) {
    const int64_t x = vector_start<T>(v, count);
    const LaneRange<T> inside(left && v == 0 ? 1 : 0, right && v == vectors - 1 ? L - 1 : L);
    vec<T> d[positions];
#pragma GCC unroll 16
    for (int p = 0; p < positions; ++p) {
      d[p] = load(rows[p] + x, inside);
      __builtin_prefetch(rows[p] + x + ahead);
    }
#pragma GCC unroll 4
    for (int z = 0; z < 4; ++z) transform_input<T>(d + 4 * z, 1);
#pragma GCC unroll 4
    for (int y = 0; y < 4; ++y) transform_input<T>(d + y, 4);
#pragma GCC unroll 16
    for (int p = 0; p < positions; ++p) store(to + p * step + x, d[p]);
  }
}

/// The products of one position: CO output channels x V vectors of `in`, the transformed rows of all input channels,
/// `pitch` apart.
template <class T, int CO, int V>
void multiply(const T* in, int64_t pitch, int64_t channels, const T* weight, T* out) {
  constexpr int L = lanes<T>;
  vec<T> sum[CO][V] = {};
  for (int64_t c = 0; c < channels; ++c, in += pitch) {
#pragma GCC unroll 3
    for (int kx = 0; kx < 3; ++kx, weight += CO) {
      vec<T> pixels[V];
#pragma GCC unroll 8
      for (int v = 0; v < V; ++v) pixels[v] = load(in + kx + v * L);
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

template <class T, int CO, int... V>
Multiply<T> pick_multiply(int64_t vectors, std::integer_sequence<int, V...>) {
  static constexpr Multiply<T> all[] = {multiply<T, CO, V + 1>...};
  return all[vectors - 1];
}
constexpr int strip_vectors = vectors_beside(max_channels);
template <class T>
Multiply<T> pick_multiply(int64_t channels, int64_t vectors) {
  constexpr auto most = std::make_integer_sequence<int, strip_vectors>{};
  if constexpr (max_channels >= 8) {
    if (channels == 8) return pick_multiply<T, 8>(vectors, most);
  }
  return channels == 1   ? pick_multiply<T, 1>(vectors, most)
         : channels == 2 ? pick_multiply<T, 2>(vectors, most)
                         : pick_multiply<T, 4>(vectors, most);
}

/// `count` columns of a tile's output rows of one channel, from the products of all positions, `step` apart. at: where
/// the four rows begin in `out` and `positive`; -1: outside the image.
template <class T>
ANYNET_INLINE void finish_strip(const T* products, int64_t step, int64_t count, T bias, bool relu, const T* positive,
                                T* out, const int64_t* at) {
  const int64_t vectors = vectors_in<T>(count);
  const vec<T> lowest = splat(relu ? T(0) : -std::numeric_limits<T>::infinity());
  for (int64_t v = 0; v < vectors; ++v) {
    const int64_t x = vector_start<T>(v, count);
    vec<T> m[positions];
#pragma GCC unroll 16
    for (int p = 0; p < positions; ++p) m[p] = load(products + p * step + x);
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) transform_output<T>(m + 4 * i, 1);
    transform_output<T>(m, 4);
    transform_output<T>(m + 1, 4);
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
template <class T>
void convolve_tiles(const Geometry& g, const Source<T>& source, const Vector<T>& weights, const T* bias, bool relu,
                    const T* positive, T* out, int threads) {
  constexpr int L = lanes<T>, most = strip_vectors;
  constexpr int64_t pitch = (most + 1) * L;  // of a transformed row
  const int64_t W = g.out_width, C = g.in_channels, O = g.out_channels, vectors = vectors_in<T>(W);
  const int64_t strips = (vectors + most - 1) / most;
  const int64_t tiles_y = (g.out_height + 1) / 2, tiles_z = (g.out_depth + 1) / 2, tiles = tiles_z * tiles_y;
  const int64_t channel = g.in_rows() * source.pitch, plane = g.out_rows() * W;
  const int64_t position = C * pitch + L;  // a power of two would put all positions into the same few cache lines
  parallel_ranges(g.batch * tiles, threads, [&](int64_t begin, int64_t end) {
    const Scratch<T> input(positions * position), products(positions * max_channels * most * L), zeros(W + 2);
    fill_zero<T>(zeros, W + 2);
    fill_zero<T>(input, positions * position);
    for (int64_t unit = begin; unit < end; ++unit) {
      const int64_t y = unit % tiles_y * 2, z = unit / tiles_y % tiles_z * 2, n = unit / tiles;
      const T* rows[positions];  // of the first channel, from column -1 on
      int64_t to_channel[positions];
      for (int p = 0; p < positions; ++p) {
        const int64_t iz = z + p / 4 - 1, iy = y + p % 4 - 1;
        const bool inside = iz >= 0 && iz < g.in_depth && iy >= 0 && iy < g.in_height;
        const T* row = source.data + n * C * channel + (iz * g.in_height + iy) * source.pitch + source.column[0];
        rows[p] = inside ? row : zeros;
        to_channel[p] = inside ? channel : 0;
      }
      for (int64_t strip = 0; strip < strips; ++strip) {
        const int64_t first = vectors * strip / strips, next = vectors * (strip + 1) / strips;
        const int64_t x = first * L, count = std::min(next * L, W) - x, row = (next - first) * L;
        const bool left = !source.padded && x == 0, right = !source.padded && x + count == W;
        const int64_t ahead = x + count < W ? count : 2 * source.pitch - x;
        const T* from[positions];
        for (int p = 0; p < positions; ++p) from[p] = rows[p] + x;
        for (int64_t c = 0; c < C; ++c) {
          transform_strip<T>(from, count + 2, left, right, ahead, input + c * pitch, position);
          for (int p = 0; p < positions; ++p) from[p] += to_channel[p];
        }
        int64_t at[4];
        for (int k = 0; k < 4; ++k) {
          const int64_t oz = z + k / 2, oy = y + k % 2;
          at[k] = oz < g.out_depth && oy < g.out_height ? (oz * g.out_height + oy) * W + x : -1;
        }
        for (int64_t o = 0, size; o < O; o += size) {
          size = block_at(o, O, max_channels);
          const auto function = pick_multiply<T>(size, next - first);
          for (int p = 0; p < positions; ++p) {
            function(input + p * position, pitch, C, weights.data() + (p * O + o) * C * 3, products + p * size * row);
          }
          for (int64_t i = 0; i < size; ++i) {
            const int64_t to = (n * O + o + i) * plane;
            finish_strip<T>(products + i * row, size * row, count, bias == nullptr ? T(0) : bias[o + i], relu,
                            positive == nullptr ? nullptr : positive + to, out + to, at);
          }
        }
      }
    }
  });
}

}  // namespace
}  // namespace anynet::ANYNET_ISA
