// Winograd's algorithm F(2x2, 3x3) over depth and height (Lavin and Gray, arXiv 1509.09308): the 2 x 2 outputs of a
// tile take 4 x 4 products of transformed rows with transformed weights instead of 4 x 9. Along the width the kernel
// slides as it does in `direct.h`, whose blocks do the products, so that a pixel's neighbours never change lanes.
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

/// Four values of the input, transformed in place.
template <class T>
ANYNET_INLINE void transform_input(vec<T>* d) {
  const vec<T> first = d[0] - d[2], sum = d[1] + d[2], difference = d[2] - d[1], last = d[1] - d[3];
  d[0] = first, d[1] = sum, d[2] = difference, d[3] = last;
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

/// The four positions of one z, for one channel: rows a[y] + sign * b[y], transformed over y, to rows `to_step` apart.
template <class T>
void transform_rows(const T* const* a, const T* const* b, T sign, int64_t width, T* to, int64_t to_step) {
  const int64_t vectors = vectors_in<T>(width);
  for (int64_t v = 0; v < vectors; ++v) {
    const int64_t x = vector_start<T>(v, width);
    vec<T> d[4];
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) d[i] = load(a[i] + x) + sign * load(b[i] + x);
    transform_input<T>(d);
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) store(to + i * to_step + x, d[i]);
  }
}

/// A tile's output rows of one channel (those that are not nullptr) from the products of all positions, `step` apart.
template <class T>
void finish_rows(const T* products, int64_t step, int64_t width, T bias, bool relu, const T* const* positive,
                 T* const* out) {
  const int64_t vectors = vectors_in<T>(width);
  const vec<T> lowest = splat(relu ? T(0) : -std::numeric_limits<T>::infinity());
  for (int64_t v = 0; v < vectors; ++v) {
    const int64_t x = vector_start<T>(v, width);
    vec<T> m[positions];
#pragma GCC unroll 16
    for (int p = 0; p < positions; ++p) m[p] = load(products + p * step + x);
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) transform_output<T>(m + 4 * i, 1);
    transform_output<T>(m, 4);
    transform_output<T>(m + 1, 4);
#pragma GCC unroll 4
    for (int k = 0; k < 4; ++k) {
      if (out[k] == nullptr) continue;
      vec<T> value = m[k / 2 * 4 + k % 2] + bias;
      value = value < lowest ? lowest : value;  // keeps NaN
      if (positive[k] != nullptr) value = load(positive[k] + x) > vec<T>{} ? value : vec<T>{};
      store(out[k] + x, value);
    }
  }
}

/// `convolve` by tiles, with weights from pack_transformed. One z of the transformed tile is computed after the other,
/// so that its rows stay in the nearest cache.
template <class T>
void convolve_tiles(const Geometry& g, const Source<T>& source, const Vector<T>& weights, const T* bias, bool relu,
                    const T* positive, T* out, int threads) {
  constexpr int L = lanes<T>;
  const int64_t W = g.out_width, C = g.in_channels, O = g.out_channels, vectors = vectors_in<T>(W);
  const int64_t pitch = round_up(W + 2, L);  // of a transformed row: a zero, the row, a zero
  const int64_t tiles_y = (g.out_height + 1) / 2, tiles_z = (g.out_depth + 1) / 2;
  const int64_t channel = g.in_rows() * source.pitch, from = source.padded ? source.column[1] : 0;
  parallel_ranges(g.batch * tiles_z * tiles_y, threads, [&](int64_t begin, int64_t end) {
    const Scratch<T> input(4 * C * pitch), products(positions * O * pitch), zeros(W);
    fill_zero<T>(zeros, W);
    for (int64_t row = 0; row < 4 * C; ++row) input[row * pitch] = input[row * pitch + W + 1] = 0;
    for (int64_t unit = begin; unit < end; ++unit) {
      const int64_t y = unit % tiles_y * 2, z = unit / tiles_y % tiles_z * 2, n = unit / tiles_y / tiles_z;
      const T* rows[positions];  // of the first channel
      bool inside[positions];
      for (int p = 0; p < positions; ++p) {
        const int64_t iz = z + p / 4 - 1, iy = y + p % 4 - 1;
        inside[p] = iz >= 0 && iz < g.in_depth && iy >= 0 && iy < g.in_height;
        rows[p] = inside[p] ? source.data + n * C * channel + (iz * g.in_height + iy) * source.pitch + from : zeros;
      }

      for (int pz = 0; pz < 4; ++pz) {
        constexpr int one[] = {0, 1, 2, 1}, other[] = {2, 2, 1, 3};
        const T sign = pz == 1 ? T(1) : T(-1);
        for (int64_t c = 0; c < C; ++c) {
          const T *a[4], *b[4];
          for (int i = 0; i < 4; ++i) {
            const int p = one[pz] * 4 + i, q = other[pz] * 4 + i;
            a[i] = rows[p] + (inside[p] ? c * channel : 0), b[i] = rows[q] + (inside[q] ? c * channel : 0);
          }
          transform_rows<T>(a, b, sign, W, input + c * pitch + 1, C * pitch);
        }
        for (int i = 0; i < 4; ++i) {
          const int p = pz * 4 + i;
          const Window<T> window{input + i * C * pitch, pitch, C, 1, {}, {}, {0, -1, -1}, {0, 1, 2}, 3, true};
          for (int64_t o = 0, size; o < O; o += size) {
            size = block_at(o, O, max_channels);
            const int64_t most = vectors_beside(static_cast<int>(size)), runs = (vectors + most - 1) / most;
            const Target<T> target{products + (p * O + o) * pitch, pitch, W, W, nullptr, false, nullptr};
            for (int64_t run = 0; run < runs; ++run) {
              const int64_t first = vectors * run / runs, next = vectors * (run + 1) / runs;
              pick<T>(size, 1, next - first, 1)(window, vector_start<T>(first, W), vector_start<T>(next - 1, W),
                                                weights.data() + (p * O + o) * C * 3, target);
            }
          }
        }
      }

      for (int64_t o = 0; o < O; ++o) {
        T* to[4];
        const T* only[4];
        for (int k = 0; k < 4; ++k) {
          const int64_t oz = z + k / 2, oy = y + k % 2;
          const int64_t at = ((n * O + o) * g.out_rows() + oz * g.out_height + oy) * W;
          to[k] = oz < g.out_depth && oy < g.out_height ? out + at : nullptr;
          only[k] = positive == nullptr || to[k] == nullptr ? nullptr : positive + at;
        }
        finish_rows<T>(products + o * pitch, O * pitch, W, bias == nullptr ? T(0) : bias[o], relu, only, to);
      }
    }
  });
}

}  // namespace
}  // namespace anynet::ANYNET_ISA
