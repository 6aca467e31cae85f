// Winograd's algorithm (Lavin and Gray, arXiv 1509.09308). In three dimensions it is F(3x3, 3x3) over depth and height:
// the 3 x 3 outputs of a tile take 5 x 5 products of transformed pixels with transformed weights instead of 9 x 9.
// Along the width the kernel slides as it does in `direct.h`, so that a pixel's neighbors never change lanes. In two
// it is F(3x2, 3x3) over height and width, and a vector of tiles is two of columns, the even and the odd ones.
//
// The transforms cost additions per channel, so this pays where channels are many. Where they are few, it is F(3, 3)
// over the height alone: the kernel slides over depth and width, and each plane is transformed once for three.
//
// All of it rounds by the largest pixel of a tile, where the direct kernel rounds by what each output sums, and a pixel
// that is NaN or infinite, or that overflows in the transforms, spreads over its whole tile.
#pragma once

#include <limits>
#include <type_traits>

#include "../common/scratch.h"
#include "direct.h"

namespace anynet::ANYNET_ISA {
namespace {

enum class Over { depth_and_height, height_and_width, height };

/// What differs between the tiles. Their outer dimension is the first of those that they are over, the inner one the
/// last.
template <class T, Over over>
struct Tiling {
  static constexpr bool flat = over == Over::height_and_width;
  static constexpr int outer = over == Over::height ? 1 : 3, inner = flat ? 2 : 3;           // outputs of a tile
  static constexpr int outer_in = outer == 1 ? 1 : outer + 2, inner_in = inner + 2;          // pixels of a tile
  static constexpr int positions = outer_in * inner_in, rows = flat ? outer_in : positions;  // that it reads
  static constexpr int taps = flat ? 1 : 3;                  // columns that a product slides over
  static constexpr int columns = (flat ? 2 : 1) * lanes<T>;  // outputs of a vector of tiles, side by side

  static int64_t vectors(int64_t width) { return vectors_in<T>(width, columns); }
  static int64_t start(int64_t vector, int64_t width) { return vector_start<T>(vector, width, columns); }
  /// Where the scratch rows have what belongs to column start(vector, width): flat ones have no neighbors.
  static int64_t slot(int64_t vector, int64_t width) { return flat ? vector * lanes<T> : start(vector, width); }

  /// Whether it computes this convolution, and faster than the direct kernel: what is saved goes with the product of
  /// the channels, the cost of the transforms with their sum.
  static bool pays(const Geometry& g) {
    const int64_t C = g.in_channels, O = g.out_channels;
    const bool many = flat                   ? C * O >= (registers == 16 ? 4 : 6) * (C + O)
                      : over == Over::height ? registers == 16 && C >= 2 && O >= 4
                                             : std::min(C, O) >= 8;
    return std::is_same_v<T, float> && g.kernel_depth == (flat ? 1 : 3) && g.stride == 1 && g.dilation == 1 && many &&
           g.out_width >= columns && g.out_height > 1 && (over != Over::depth_and_height || g.out_depth > 1);
  }
};

/// `outputs` + 2 values of the input, `step` apart, transformed in place: for outputs from the points 0, 1, -1,
/// infinity and, if there are three, 1/2.
template <class T, int outputs>
ANYNET_INLINE void transform_input(vec<T>* d, int step) {
  if constexpr (outputs == 2) {
    const vec<T> first = d[0] - d[2 * step], sum = d[step] + d[2 * step];
    const vec<T> difference = d[2 * step] - d[step], last = d[step] - d[3 * step];
    d[0] = first, d[step] = sum, d[2 * step] = difference, d[3 * step] = last;
  } else {
    const vec<T> half = splat(T(0.5)), across = d[3 * step] - d[step], near = half * (d[2 * step] - d[step]);
    const vec<T> first = across + half * (d[0] - d[2 * step]), sum = d[3 * step] + near;
    const vec<T> difference = d[3 * step] - d[2 * step] - near, last = d[4 * step] - d[2 * step] - half * across;
    d[0] = first, d[step] = sum, d[2 * step] = difference, d[3 * step] = across, d[4 * step] = last;
  }
}

/// One weight of each output channel of a block.
template <class T>
struct BlockOf;
template <>
struct BlockOf<float> {
  typedef float weights __attribute__((vector_size(max_channels * sizeof(float))));
};
template <>
struct BlockOf<double> {
  typedef double weights __attribute__((vector_size(max_channels * sizeof(double))));
};
template <class T>
using Weights = typename BlockOf<T>::weights;

/// Three weights `step` apart to `outputs` + 2, `to_step` apart.
template <class T, int outputs>
ANYNET_INLINE void transform_weights(const Weights<T>* g, int step, Weights<T>* to, int to_step) {
  const Weights<T> outer = g[0] + g[2 * step];
  if constexpr (outputs == 2) {
    to[0] = g[0];
    to[to_step] = (outer + g[step]) / T(2);
    to[2 * to_step] = (outer - g[step]) / T(2);
    to[3 * to_step] = g[2 * step];
  } else {
    to[0] = T(2) * g[0];
    to[to_step] = outer + g[step];
    to[2 * to_step] = (g[step] - outer) / T(3);
    to[3 * to_step] = -(T(4) * g[0] + T(2) * g[step] + g[2 * step]) * T(2) / T(3);
    to[4 * to_step] = g[2 * step];
  }
}

/// `outputs` + 2 sums of products, `step` apart, to the outputs: the first ones of them.
template <class T, int outputs>
ANYNET_INLINE void transform_output(vec<T>* m, int step) {
  const vec<T> sum = m[step] + m[2 * step], difference = m[step] - m[2 * step];
  if constexpr (outputs == 2) {
    m[0] += sum, m[step] = difference - m[3 * step];
  } else {
    m[0] += sum + m[3 * step];
    m[step] = difference + T(0.5) * m[3 * step];
    m[2 * step] = sum + T(0.25) * m[3 * step] + m[4 * step];
  }
}

/// From the weights of a position to those of the next one, for `kernel` weights per output channel. A power of two
/// would put all of them into the same few cache lines.
int64_t weights_of_position(int64_t out_channels, int64_t kernel) { return out_channels * kernel + 16; }

/// [position][block of output channels][depth][in_channels][kx][channel of the block], from weight(o, c, tap and kx);
/// depth and kx are those over which the kernel slides.
template <class T, Over over, class Weight>
Vector<T> pack_transformed(const Geometry& g, const Weight& weight) {
  using Tiles = Tiling<T, over>;
  constexpr int taps = Tiles::taps, inner_in = Tiles::inner_in, outer_taps = Tiles::outer == 1 ? 1 : 3;
  const int64_t depth = over == Over::height ? 3 : 1, tap = 3 * outer_taps * taps;
  const int64_t size_of_channel = depth * g.in_channels * taps;
  const int64_t position = weights_of_position(g.out_channels, size_of_channel);
  Vector<T> packed(Tiles::positions * position);
  const auto pack_block = [&](int64_t o, auto size) {
    for (int64_t slide = 0; slide < size_of_channel; ++slide) {
      const int64_t k = slide % taps, c = slide / taps % g.in_channels, z = slide / taps / g.in_channels;
      Weights<T> rows[3 * inner_in], all[Tiles::positions];  // transformed over the inner dimension, then over both
      for (int row = 0; row < outer_taps; ++row) {
        T given[3][max_channels] = {};
        for (int t = 0; t < 3; ++t) {
          for (int64_t i = 0; i < size; ++i) given[t][i] = weight(o + i, c, z * tap + (row * 3 + t) * taps + k);
        }
        Weights<T> inner[3];
        std::memcpy(inner, given, sizeof(inner));
        transform_weights<T, Tiles::inner>(inner, 1, rows + inner_in * row, 1);
      }
      for (int t = 0; t < inner_in; ++t) {
        if constexpr (Tiles::outer == 1) {
          all[t] = rows[t];
        } else {
          transform_weights<T, Tiles::outer>(rows + t, inner_in, all + t, inner_in);
        }
      }
      T* to = packed.data() + o * size_of_channel + slide * size;
      for (int p = 0; p < Tiles::positions; ++p) std::memcpy(to + p * position, all + p, size * sizeof(T));
    }
  };
  for (int64_t o = 0, size; o < g.out_channels; o += size) {
    size = block_at(o, g.out_channels, max_channels);
    if (size == max_channels) {
      pack_block(o, std::integral_constant<int64_t, max_channels>{});
    } else {
      pack_block(o, size);
    }
  }
  return packed;
}

/// Pairs of neighboring columns, one tile each, apart and together again. In between, the tiles of a vector are in an
/// order in which its parts of 16 bytes get them from themselves: shuffles across those take several times as long.
template <class T>
constexpr int part = 16 / sizeof(T);
template <class T, int parity, int... I>
ANYNET_INLINE vec<T> split_pairs(vec<T> a, vec<T> b, std::integer_sequence<int, I...>) {
  constexpr int half = part<T> / 2;
  return shuffle<(I / part<T> * part<T> + I % half * 2 + parity + I / half % 2 * lanes<T>)...>(a, b);
}
/// The first or the second half of the columns.
template <class T, int second, int... I>
ANYNET_INLINE vec<T> join_pairs(vec<T> even, vec<T> odd, std::integer_sequence<int, I...>) {
  constexpr int half = part<T> / 2;
  return shuffle<(I / part<T> * part<T> + I % part<T> / 2 + second * half + I % 2 * lanes<T>)...>(even, odd);
}

/// The pixels of a vector of tiles, `x` columns to the right of `rows`. left, right: the first column, or the
/// last, lies outside the image, and is 0.
template <class T, Over over>
ANYNET_INLINE void load_tiles(const T* const* rows, int64_t x, bool left, bool right, vec<T>* d) {
  constexpr int L = lanes<T>;
  if constexpr (Tiling<T, over>::flat) {
    const auto load_rows = [&](auto first, auto last) __attribute__((always_inline)) {
#pragma GCC unroll 5
      for (int y = 0; y < Tiling<T, over>::outer_in; ++y) {
        const T* row = rows[y] + x;
        const vec<T> before[2] = {load(row, first), load(row + L)};
        const vec<T> after[2] = {load(row + 2), load(row + 2 + L, last)};
        vec<T>* to = d + Tiling<T, over>::inner_in * y;
        to[0] = split_pairs<T, 0>(before[0], before[1], lane_sequence<T>{});
        to[1] = split_pairs<T, 1>(before[0], before[1], lane_sequence<T>{});
        to[2] = split_pairs<T, 0>(after[0], after[1], lane_sequence<T>{});
        to[3] = split_pairs<T, 1>(after[0], after[1], lane_sequence<T>{});
      }
    };
    if (left || right) {
      load_rows(LaneRange<T>(left ? 1 : 0, L), LaneRange<T>(0, right ? L - 1 : L));
    } else {
      load_rows(AllLanes{}, AllLanes{});
    }
  } else if (!left && !right) {
#pragma GCC unroll 25
    for (int p = 0; p < Tiling<T, over>::positions; ++p) d[p] = load(rows[p] + x);
  } else {
    const LaneRange<T> inside(left ? 1 : 0, right ? L - 1 : L);
#pragma GCC unroll 25
    for (int p = 0; p < Tiling<T, over>::positions; ++p) d[p] = load(rows[p] + x, inside);
  }
}

/// `size` or a little more: an odd number of cache lines.
template <class T>
constexpr int64_t odd_lines(int64_t size) {
  constexpr int64_t line = 64 / sizeof(T);
  return ((size + line - 1) / line | 1) * line;
}

constexpr int strip_vectors = (registers - 1) / (max_channels + 1);  // that are multiplied at once

/// What a thread keeps of a strip: its transformed rows, and their products. Those of a channel lie together, so that
/// the transforms find them at constant distances. Where positions are many those of a position do, which multiplies
/// faster: it reads neighboring rows. A power of two between them would put all of them into the same few cache lines.
template <class T, Over over>
class StripScratch {
  static constexpr bool by_position = over == Over::depth_and_height;
  static constexpr int positions = Tiling<T, over>::positions;

 public:
  // Where a kernel slides, rows of twice as many vectors as are multiplied at once: the two columns that it needs more
  // cost half.
  static constexpr int vectors = (Tiling<T, over>::taps > 1 ? 2 : 1) * strip_vectors;
  // From one channel to the next.
  static constexpr int64_t row = (vectors + 1) * lanes<T>, product = strip_vectors * lanes<T>;
  static constexpr int64_t row_step = by_position ? row : odd_lines<T>(positions * row);
  static constexpr int64_t product_step = by_position ? product : positions * product;

 private:
  const int64_t all_rows_, all_products_;  // of a position

 public:
  const Scratch<T> rows, products, zeros;

  /// For so many transformed rows of a position, and images of that width.
  StripScratch(int64_t count, int64_t out_channels, int64_t width)
      : all_rows_(odd_lines<T>(count * row)),
        all_products_(odd_lines<T>(out_channels * product)),
        rows(by_position ? positions * all_rows_ : count * row_step),
        products(positions * all_products_),
        zeros(width + 2) {
    fill_zero<T>(rows, by_position ? positions * all_rows_ : count * row_step);
    fill_zero<T>(zeros, width + 2);
  }

  // From one position to the next.
  int64_t row_position() const { return by_position ? all_rows_ : row; }
  int64_t product_position() const { return by_position ? all_products_ : product; }

  /// Moves on by such a distance once `v` is there. Compilers would compute all addresses first, and keep them in
  /// memory.
  template <class P>
  static ANYNET_INLINE void advance(P*& at, int64_t distance, vec<T>& v) {
    at += distance;
    if constexpr (by_position) read_after(at, v);
  }
};

/// `count` columns of a channel's rows, transformed, to those of the scratch from `to` on. left, right: see
/// `load_tiles`. `ahead`: how much further on the rows will be read next.
template <class T, Over over>
ANYNET_INLINE void transform_strip(const T* const* rows, int64_t count, bool left, bool right, int64_t ahead,
                                   const StripScratch<T, over>& scratch, T* to) {
  using Tiles = Tiling<T, over>;
  const int64_t vectors = Tiles::vectors(count);
  for (int64_t v = 0; v < vectors; ++v) {
    const int64_t x = Tiles::start(v, count), slot = Tiles::slot(v, count);
    vec<T> d[Tiles::positions];
    load_tiles<T, over>(rows, x, left && v == 0, right && v == vectors - 1, d);
#pragma GCC unroll 25
    for (int r = 0; r < Tiles::rows; ++r) {
      if (v * Tiles::columns * sizeof(T) % 64 == 0) __builtin_prefetch(rows[r] + x + ahead);
    }
#pragma GCC unroll 5
    for (int i = 0; i < Tiles::outer_in; ++i) transform_input<T, Tiles::inner>(d + Tiles::inner_in * i, 1);
#pragma GCC unroll 5
    for (int i = 0; i < Tiles::inner_in; ++i) {
      if constexpr (Tiles::outer > 1) transform_input<T, Tiles::outer>(d + i, Tiles::inner_in);
    }
    T* at = to + slot;
#pragma GCC unroll 25
    for (int p = 0; p < Tiles::positions; ++p) {
      store(at, d[p]);
      scratch.advance(at, scratch.row_position(), d[p]);
    }
  }
}

/// The products of one position: CO output channels x V vectors of `in`, the transformed rows of all input channels.
template <class T, Over over, int CO, int V>
void multiply(const T* in, int64_t channels, const T* weight, T* out) {
  constexpr int L = lanes<T>;
  vec<T> sum[CO][V] = {};
  for (int64_t c = 0; c < channels; ++c, in += StripScratch<T, over>::row_step) {
#pragma GCC unroll 3
    for (int k = 0; k < Tiling<T, over>::taps; ++k, weight += CO) {
      vec<T> pixels[V];
#pragma GCC unroll 8
      for (int v = 0; v < V; ++v) pixels[v] = load(in + k + v * L);
      add_products<T>(sum, weight, 0, pixels);
    }
  }
#pragma GCC unroll 8
  for (int o = 0; o < CO; ++o) {
#pragma GCC unroll 8
    for (int v = 0; v < V; ++v) store(out + o * StripScratch<T, over>::product_step + v * L, sum[o][v]);
  }
}

template <class T>
using Multiply = void (*)(const T*, int64_t, const T*, T*);

template <class T, Over over, int CO, int... V>
Multiply<T> pick_multiply(int64_t vectors, std::integer_sequence<int, V...>) {
  static constexpr Multiply<T> all[] = {multiply<T, over, CO, V + 1>...};
  return all[vectors - 1];
}
template <class T, Over over>
Multiply<T> pick_multiply(int64_t channels, int64_t vectors) {
  constexpr auto most = std::make_integer_sequence<int, strip_vectors>{};
  if constexpr (max_channels >= 8) {
    if (channels == 8) return pick_multiply<T, over, 8>(vectors, most);
  }
  return channels == 1   ? pick_multiply<T, over, 1>(vectors, most)
         : channels == 2 ? pick_multiply<T, over, 2>(vectors, most)
                         : pick_multiply<T, over, 4>(vectors, most);
}

/// `count` columns of a tile's output rows of one channel, from the products of the scratch from `products` on. at:
/// where the vectors of outputs begin in `out` and `positive`; -1: outside the image.
template <class T, Over over>
ANYNET_INLINE void finish_strip(const StripScratch<T, over>& scratch, const T* products, int64_t count, T bias,
                                bool relu, const T* positive, T* out, const int64_t* at) {
  using Tiles = Tiling<T, over>;
  const int64_t vectors = Tiles::vectors(count);
  const vec<T> lowest = splat(relu ? T(0) : -std::numeric_limits<T>::infinity());
  for (int64_t v = 0; v < vectors; ++v) {
    const int64_t x = Tiles::start(v, count), slot = Tiles::slot(v, count);
    vec<T> m[Tiles::positions];
    const T* from = products + slot;
#pragma GCC unroll 25
    for (int p = 0; p < Tiles::positions; ++p) {
      m[p] = load(from);
      scratch.advance(from, scratch.product_position(), m[p]);
    }
#pragma GCC unroll 5
    for (int i = 0; i < Tiles::outer_in; ++i) transform_output<T, Tiles::inner>(m + Tiles::inner_in * i, 1);
#pragma GCC unroll 3
    for (int i = 0; i < Tiles::inner; ++i) {
      if constexpr (Tiles::outer > 1) transform_output<T, Tiles::outer>(m + i, Tiles::inner_in);
    }
    if constexpr (Tiles::flat) {
#pragma GCC unroll 3
      for (int y = 0; y < Tiles::outer; ++y) {
        const vec<T> even = m[Tiles::inner_in * y], odd = m[Tiles::inner_in * y + 1];
        m[Tiles::inner_in * y] = join_pairs<T, 0>(even, odd, lane_sequence<T>{});
        m[Tiles::inner_in * y + 1] = join_pairs<T, 1>(even, odd, lane_sequence<T>{});
      }
    }
#pragma GCC unroll 9
    for (int k = 0; k < Tiles::outer * Tiles::inner; ++k) {
      if (at[k] < 0) continue;
      vec<T> value = m[k / Tiles::inner * Tiles::inner_in + k % Tiles::inner] + bias;
      value = value < lowest ? lowest : value;  // keeps NaN
      if (positive != nullptr) value = load(positive + at[k] + x) > vec<T>{} ? value : vec<T>{};
      store(out + at[k] + x, value);
    }
  }
}

/// Asks for the memory that finish_strip will write.
template <class T, Over over>
ANYNET_INLINE void prefetch_strip(T* out, const int64_t* at, int64_t count) {
  using Tiles = Tiling<T, over>;
  for (int k = 0; k < Tiles::outer * Tiles::inner; ++k) {
    if (at[k] < 0) continue;
    for (int64_t i = 0; i < count; i += Tiles::columns) __builtin_prefetch(out + at[k] + i, 1);
  }
}

/// Where a strip's outputs go: `count` columns, in `vectors` vectors, from at[] (see finish_strip) on in each of the
/// channels of `out`, `plane` apart.
template <class T>
struct StripTarget {
  int64_t channels, plane, vectors, count;
  const T* bias;
  bool relu;
  const T* positive;
  T* out;
  const int64_t* at;
};

/// Those of the outputs of a strip that are multiplied at once. What slides are, per position, the `slides` transformed
/// rows from `first` on, and as many of the weights (`kernel` per output channel) after those of `skipped` rows.
template <class T, Over over>
void convolve_part(const StripScratch<T, over>& scratch, const T* first, int64_t slides, const T* weights,
                   int64_t kernel, int64_t skipped, const StripTarget<T>& to) {
  using Tiles = Tiling<T, over>;
  constexpr int taps = Tiles::taps, positions = Tiles::positions;
  const int64_t O = to.channels;
  for (int p = 0; p < positions; ++p) {
    for (int64_t o = O * p / positions; o < O * (p + 1) / positions; ++o) {
      prefetch_strip<T, over>(to.out + o * to.plane, to.at, to.count);
    }
    for (int64_t o = 0, size; o < O; o += size) {
      size = block_at(o, O, max_channels);
      pick_multiply<T, over>(size, to.vectors)(
          first + p * scratch.row_position(), slides,
          weights + p * weights_of_position(O, kernel) + o * kernel + skipped * taps * size,
          scratch.products + p * scratch.product_position() + o * scratch.product_step);
    }
  }
  for (int64_t o = 0; o < O; ++o) {
    finish_strip<T, over>(scratch, scratch.products + o * scratch.product_step, to.count,
                          to.bias == nullptr ? T(0) : to.bias[o], to.relu,
                          to.positive == nullptr ? nullptr : to.positive + o * to.plane, to.out + o * to.plane, to.at);
  }
}

/// All outputs of a strip, as convolve_part.
template <class T, Over over>
void convolve_strip(const StripScratch<T, over>& scratch, const T* first, int64_t slides, const T* weights,
                    int64_t kernel, int64_t skipped, const StripTarget<T>& strip) {
  using Tiles = Tiling<T, over>;
  if (strip.vectors <= strip_vectors) {
    return convolve_part<T, over>(scratch, first, slides, weights, kernel, skipped, strip);
  }
  const int64_t parts = (strip.vectors + strip_vectors - 1) / strip_vectors;
  for (int64_t part = 0; part < parts; ++part) {
    const int64_t from = strip.vectors * part / parts, to = strip.vectors * (part + 1) / parts;
    const int64_t column = from * Tiles::columns;
    int64_t at[Tiles::outer * Tiles::inner];
    for (int k = 0; k < Tiles::outer * Tiles::inner; ++k) at[k] = strip.at[k] < 0 ? -1 : strip.at[k] + column;
    StripTarget<T> target = strip;
    target.vectors = to - from, target.count = std::min(to * Tiles::columns, strip.count) - column, target.at = at;
    convolve_part<T, over>(scratch, first + from * lanes<T>, slides, weights, kernel, skipped, target);
  }
}

/// `convolve` by tiles, with weights from pack_transformed. A tile goes in strips of columns, so that the transformed
/// rows and the products stay in the nearest caches.
template <class T, Over over>
void convolve_tiles(const Geometry& g, const Source<T>& source, const Vector<T>& weights, const T* bias, bool relu,
                    const T* positive, T* out, int threads) {
  using Tiles = Tiling<T, over>;
  constexpr bool flat = Tiles::flat;
  constexpr int L = lanes<T>, taps = Tiles::taps;
  constexpr int tall = flat ? Tiles::outer : Tiles::inner, deep = flat ? 1 : Tiles::outer;  // outputs of a tile
  const int64_t W = g.out_width, C = g.in_channels, O = g.out_channels, vectors = Tiles::vectors(W);
  constexpr int wide = StripScratch<T, over>::vectors;
  const int64_t strips = (vectors + wide - 1) / wide;
  const int64_t tiles_y = (g.out_height + tall - 1) / tall, tiles_z = (g.out_depth + deep - 1) / deep;
  const int64_t tiles = tiles_z * tiles_y, channel = g.in_rows() * source.pitch, plane = g.out_rows() * W;
  parallel_ranges(g.batch * tiles, threads, [&](int64_t begin, int64_t end) {
    const StripScratch<T, over> scratch(C, O, W);
    for (int64_t unit = begin; unit < end; ++unit) {
      const int64_t y = unit % tiles_y * tall, z = unit / tiles_y % tiles_z * deep, n = unit / tiles;
      const T* rows[Tiles::rows];  // of the first channel, from column -1 on
      int64_t to_channel[Tiles::rows];
      for (int r = 0; r < Tiles::rows; ++r) {
        const int64_t iz = flat ? z : z + r / (tall + 2) - 1, iy = y + r % (tall + 2) - 1;
        const bool inside = iz >= 0 && iz < g.in_depth && iy >= 0 && iy < g.in_height;
        const T* row = source.data + n * C * channel + (iz * g.in_height + iy) * source.pitch + source.column[0];
        rows[r] = inside ? row : scratch.zeros;
        to_channel[r] = inside ? channel : 0;
      }
      for (int64_t strip = 0; strip < strips; ++strip) {
        const int64_t first = vectors * strip / strips, next = vectors * (strip + 1) / strips;
        const int64_t x = first * Tiles::columns, count = std::min(next * Tiles::columns, W) - x;
        const bool left = !source.padded && x == 0, right = !source.padded && x + count == W;
        const int64_t ahead = x + count < W ? count : tall * source.pitch - x;
        const T* from[Tiles::rows];
        for (int r = 0; r < Tiles::rows; ++r) from[r] = rows[r] + x;
        for (int64_t c = 0; c < C; ++c) {
          // What slides needs two columns more.
          transform_strip<T, over>(from, count + taps - 1, left, right, ahead, scratch,
                                   scratch.rows + c * scratch.row_step);
          for (int r = 0; r < Tiles::rows; ++r) from[r] += to_channel[r];
        }
        int64_t at[Tiles::outer * Tiles::inner];
        for (int k = 0; k < Tiles::outer * Tiles::inner; ++k) {
          const int i = k / Tiles::inner, j = k % Tiles::inner;
          const int64_t oz = z + (flat ? 0 : i), oy = y + (flat ? i : j), column = x + (flat ? j * L : 0);
          at[k] = oz < g.out_depth && oy < g.out_height ? (oz * g.out_height + oy) * W + column : -1;
        }
        const int64_t image = n * O * plane;
        convolve_strip<T, over>(scratch, scratch.rows, C, weights.data(), C * taps, 0,
                                {O, plane, next - first, count, bias, relu,
                                 positive == nullptr ? nullptr : positive + image, out + image, at});
      }
    }
  });
}

constexpr int64_t slid_planes = 8;  // planes of outputs at a time, whose transformed rows stay in the nearest caches

/// The same, over the height alone: all planes of a strip are transformed, then each output's three are multiplied.
template <class T>
void convolve_heights(const Geometry& g, const Source<T>& source, const Vector<T>& weights, const T* bias, bool relu,
                      const T* positive, T* out, int threads) {
  constexpr Over over = Over::height;
  using Tiles = Tiling<T, over>;
  constexpr int L = lanes<T>, taps = Tiles::taps, tall = Tiles::inner;
  const int64_t W = g.out_width, C = g.in_channels, O = g.out_channels, vectors = Tiles::vectors(W);
  constexpr int wide = StripScratch<T, over>::vectors;
  const int64_t strips = (vectors + wide - 1) / wide;
  const int64_t tiles_y = (g.out_height + tall - 1) / tall, tiles_z = (g.out_depth + slid_planes - 1) / slid_planes;
  const int64_t in_plane = g.in_height * source.pitch, channel = g.in_depth * in_plane, plane = g.out_rows() * W;
  parallel_ranges(g.batch * tiles_z * tiles_y, threads, [&](int64_t begin, int64_t end) {
    const StripScratch<T, over> scratch(std::min(slid_planes + 2, g.in_depth) * C, O, W);
    for (int64_t unit = begin; unit < end; ++unit) {
      const int64_t y = unit % tiles_y * tall, z = unit / tiles_y % tiles_z * slid_planes, n = unit / tiles_y / tiles_z;
      const int64_t begin_z = std::max<int64_t>(0, z - 1), end_z = std::min(g.in_depth, z + slid_planes + 1);
      const T* rows[Tiles::rows];  // of the first plane and channel, from column -1 on
      int64_t to_plane[Tiles::rows], to_channel[Tiles::rows];
      for (int r = 0; r < Tiles::rows; ++r) {
        const int64_t iy = y + r - 1;
        const bool inside = iy >= 0 && iy < g.in_height;
        rows[r] = inside ? source.data + n * C * channel + begin_z * in_plane + iy * source.pitch + source.column[0]
                         : scratch.zeros;
        to_plane[r] = inside ? in_plane : 0, to_channel[r] = inside ? channel : 0;
      }
      for (int64_t strip = 0; strip < strips; ++strip) {
        const int64_t first = vectors * strip / strips, next = vectors * (strip + 1) / strips, x = first * L;
        const int64_t count = std::min(next * L, W) - x;
        const bool left = !source.padded && x == 0, right = !source.padded && x + count == W;
        const int64_t ahead = x + count < W ? count : tall * source.pitch - x;
        T* to = scratch.rows;
        for (int64_t iz = begin_z; iz < end_z; ++iz) {
          const T* from[Tiles::rows];
          for (int r = 0; r < Tiles::rows; ++r) from[r] = rows[r] + (iz - begin_z) * to_plane[r] + x;
          for (int64_t c = 0; c < C; ++c, to += scratch.row_step) {
            transform_strip<T, over>(from, count + taps - 1, left, right, ahead, scratch, to);
            for (int r = 0; r < Tiles::rows; ++r) from[r] += to_channel[r];
          }
        }
        const int64_t image = n * O * plane;
        for (int64_t oz = z; oz < std::min(z + slid_planes, g.out_depth); ++oz) {
          const int64_t from_z = std::max(begin_z, oz - 1), to_z = std::min(end_z, oz + 2);
          int64_t at[tall];
          for (int64_t r = 0; r < tall; ++r) {
            at[r] = y + r < g.out_height ? (oz * g.out_height + y + r) * W + x : -1;
          }
          convolve_strip<T, over>(scratch, scratch.rows + (from_z - begin_z) * C * scratch.row_step,
                                  (to_z - from_z) * C, weights.data(), 3 * C * taps, (from_z - oz + 1) * C,
                                  {O, plane, next - first, count, bias, relu,
                                   positive == nullptr ? nullptr : positive + image, out + image, at});
        }
      }
    }
  });
}

}  // namespace
}  // namespace anynet::ANYNET_ISA
