// The direct kernel: a block of output channels x a run of pixel vectors of one output row stays in registers while the
// rows that it reads go by (`block`). Output rows are independent, so the threads share them.
//
// Rows are read where they are. The last vector of a row ends where the row ends, and computes some pixels of the
// vector before it again; columns -1 and W are zeros shifted into the first and last vector. Only what this cannot
// express is first copied to padded rows (`Source`): stride 2, the affine and ReLU of the input, and rows shorter than
// a vector.
#pragma once

#include <algorithm>
#include <limits>
#include <utility>

#include "../common/parallel.h"
#include "../common/simd.h"
#include "../common/vector.h"
#include "conv.h"

#if defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace anynet::ANYNET_ISA {
namespace {

#if defined(__AVX512F__) || defined(__aarch64__)
constexpr int registers = 32;
#else
constexpr int registers = 16;
#endif
constexpr int max_channels = registers / 4;  // of a block

template <class T>
using lane_sequence = std::make_integer_sequence<int, lanes<T>>;

/// Keeps the compiler from reading through `p` before it has computed `v`, where it would run out of registers.
template <class P, class V>
ANYNET_INLINE void read_after(P*& p, V& v) {
#if defined(__x86_64__)
  asm("" : "+r"(p), "+v"(v));
#elif defined(__aarch64__)
  asm("" : "+r"(p), "+w"(v));
#endif
}

#if defined(__aarch64__)
/// sum + a * b[lane]
template <int lane>
ANYNET_INLINE vec<float> add_lane_product(vec<float> sum, vec<float> a, vec<float> b) {
  return reinterpret_cast<vec<float>>(vfmaq_laneq_f32(
      reinterpret_cast<float32x4_t>(sum), reinterpret_cast<float32x4_t>(a), reinterpret_cast<float32x4_t>(b), lane));
}
template <int lane>
ANYNET_INLINE vec<double> add_lane_product(vec<double> sum, vec<double> a, vec<double> b) {
  return reinterpret_cast<vec<double>>(vfmaq_laneq_f64(
      reinterpret_cast<float64x2_t>(sum), reinterpret_cast<float64x2_t>(a), reinterpret_cast<float64x2_t>(b), lane));
}

template <class T, int CO, int V, int... O>
ANYNET_INLINE void add_products_by_lane(vec<T> (&sum)[CO][V], const T*& weight, int64_t at, const vec<T> (&pixels)[V],
                                        std::integer_sequence<int, O...>) {
  constexpr int L = lanes<T>;
  vec<T> weights[CO / L];
#pragma GCC unroll 8
  for (int k = 0; k < CO / L; ++k) weights[k] = load(weight + at + k * L);
  const auto add = [&](auto o) __attribute__((always_inline)) {
#pragma GCC unroll 8
    for (int v = 0; v < V; ++v) sum[o()][v] = add_lane_product<o() % L>(sum[o()][v], pixels[v], weights[o() / L]);
  };
  (add(Constant<O>{}), ...);
  read_after(weight, sum[CO - 1][V - 1]);
}
#endif

/// sum[o][v] += weight[at + o] * pixels[v]
template <class T, int CO, int V>
ANYNET_INLINE void add_products(vec<T> (&sum)[CO][V], const T*& weight, int64_t at, const vec<T> (&pixels)[V]) {
#if defined(__aarch64__)
  // A lane of a register is an operand of its own; a vector of one weight would need an instruction of the same ports.
  if constexpr (CO % lanes<T> == 0) {
    return add_products_by_lane<T>(sum, weight, at, pixels, std::make_integer_sequence<int, CO>{});
  }
#endif
#pragma GCC unroll 8
  for (int o = 0; o < CO; ++o) {
    const vec<T> wo = splat(weight[at + o]);
#pragma GCC unroll 8
    for (int v = 0; v < V; ++v) add_product<T>(sum[o][v], wo, pixels[v]);
    read_after(weight, sum[o][V - 1]);
  }
}

/// How many vectors of so many columns cover a row, the last one moved back to end where the row ends.
template <class T>
int64_t vectors_in(int64_t width, int64_t columns = lanes<T>) {
  return (width + columns - 1) / columns;
}
template <class T>
int64_t vector_start(int64_t index, int64_t width, int64_t columns = lanes<T>) {
  return std::max<int64_t>(0, std::min<int64_t>(index * columns, width - columns));
}

/// The even or the odd elements of two vectors.
template <class T, int odd, int... I>
ANYNET_INLINE vec<T> deinterleave(vec<T> a, vec<T> b, std::integer_sequence<int, I...>) {
  return shuffle<(2 * I + odd)...>(a, b);
}

/// The even and the odd columns of a row apart, each through `f`.
template <class T, class F>
void deinterleave_columns(const T* from, int64_t width, const F& f, T* even, T* odd) {
  int64_t x = 0;
  for (; x + 2 * lanes<T> <= width; x += 2 * lanes<T>) {
    const vec<T> first = f(load(from + x)), second = f(load(from + x + lanes<T>));
    store(even + x / 2, deinterleave<T, 0>(first, second, lane_sequence<T>{}));
    store(odd + x / 2, deinterleave<T, 1>(first, second, lane_sequence<T>{}));
  }
  for (; x < width; ++x) (x % 2 == 0 ? even : odd)[x / 2] = f(from[x]);
}

/// A tensor's rows as the kernels read them: output column x sees through kx the element column[kx] + x of a row.
template <class T>
struct Source {
  const T* data;
  int64_t pitch;  // from a row to the next
  int64_t column[3];
  bool padded;  // false: the tensor itself, in which columns -1 and W do not exist
  Vector<T> copy;

  /// The tensor itself.
  Source(const T* tensor, int64_t width) : data(tensor), pitch(width), column{-1, 0, 1}, padded(false) {}

  /// activate(row)(elements) of each row's elements, for rows of `reach` output columns. With stride 2 the odd columns
  /// come first, then the even ones; with dilation 2 there are zeros between the elements.
  template <class F>
  Source(const T* tensor, int64_t rows, int64_t width, int64_t reach, int64_t stride, int64_t dilation, int threads,
         const F& activate)
      : padded(true) {
    const int64_t half = (vectors_in<T>(reach) + 1) * lanes<T>;
    pitch = half * stride;
    column[0] = 0, column[1] = stride == 2 ? half : 1, column[2] = stride == 2 ? 1 : 2;
    copy.resize(rows * pitch);
    data = copy.data();
    parallel_for(rows, threads, [&](int64_t r) {
      const T* from = tensor + r * width;
      T* to = copy.data() + r * pitch;
      std::fill_n(to, pitch, T(0));
      const auto f = activate(r);
      if (stride == 2) {
        deinterleave_columns<T>(from, width, f, to + half, to + 1);
      } else if (dilation == 1) {
        for (int64_t x = 0; x < width; ++x) to[1 + x] = f(from[x]);
      } else {
        for (int64_t x = 0; x < width; ++x) to[1 + x * dilation] = f(from[x]);
      }
    });
  }
};

/// Calls body(n, count) for images [n, n + count) at a time: all of them, or as many as may be copied to padded rows
/// without leaving the caches, and memory that malloc keeps (fresh pages take longer than the copy).
template <class Body>
void by_images(int64_t batch, int64_t bytes_of_copy, const Body& body) {
  constexpr int64_t cache = 4 << 20;
  const int64_t step = bytes_of_copy == 0 ? batch : std::max<int64_t>(1, cache / bytes_of_copy);
  for (int64_t n = 0; n < batch; n += step) body(n, std::min(step, batch - n));
}

/// A convolution of output rows: the forward pass, or the gradient of the input as the convolution of the gradient
/// with the kernel turned around. Output position o reads position o * stride + tap - 1 of an input whose elements are
/// `dilation` apart, with zeros between them; stride or dilation is 1.
struct Geometry {
  int64_t batch, in_channels, out_channels, kernel_depth, stride, dilation;
  int64_t in_depth, in_height, in_width;
  int64_t out_depth, out_height, out_width;

  explicit Geometry(const ConvShape& s)
      : batch(s.batch),
        in_channels(s.in_channels),
        out_channels(s.out_channels),
        kernel_depth(s.kernel_depth),
        stride(s.stride),
        dilation(1),
        in_depth(s.depth),
        in_height(s.height),
        in_width(s.width),
        out_depth(kernel_depth == 1 ? s.depth : strided(s.depth)),
        out_height(strided(s.height)),
        out_width(strided(s.width)) {}

  Geometry backward() const {
    Geometry g = *this;
    std::swap(g.in_channels, g.out_channels);
    std::swap(g.stride, g.dilation);
    std::swap(g.in_depth, g.out_depth);
    std::swap(g.in_height, g.out_height);
    std::swap(g.in_width, g.out_width);
    return g;
  }

  int64_t strided(int64_t size) const { return (size + stride - 1) / stride; }
  /// As many threads as the work is worth waking.
  int threads(int available) const {
    return useful_threads(available, batch, out_channels, out_rows(), out_width, in_channels, taps(), 0.375);
  }
  int64_t taps() const { return 3 * kernel_depth; }
  int64_t in_rows() const { return in_depth * in_height; }
  int64_t out_rows() const { return out_depth * out_height; }
  int64_t in_size() const { return in_channels * in_rows() * in_width; }  // of an image
  int64_t out_size() const { return out_channels * out_rows() * out_width; }
  Geometry of(int64_t images) const {
    Geometry g = *this;
    g.batch = images;
    return g;
  }

  /// The position in an input of `size` that output position `o` reads through tap `t`, or -1.
  int64_t tap(int64_t o, int64_t t, int64_t size) const {
    const int64_t i = o * stride + t - 1;
    if (dilation == 1) return i < size ? i : -1;  // divisions take longer than a short row
    return i < 0 || i % dilation != 0 || i / dilation >= size ? -1 : i / dilation;
  }
  int64_t plane(int64_t z, int64_t kz) const { return kernel_depth == 1 ? z : tap(z, kz, in_depth); }
  int64_t row(int64_t y, int64_t ky) const { return tap(y, ky, in_height); }
};

// --------------------------------------------------------------------------------- forward and gradient of the input

constexpr int max_rows = 4;

/// As many output rows as share a block whose channels alone would leave registers free.
constexpr int rows_beside(int channels) { return std::min(max_rows, max_channels / channels); }
/// As many vectors as fit, besides one register for a weight (of one channel, for its three of a column) and, per
/// vector, one for a tap's pixels. Of several channels one more stays free, unless add_product sees to it: compilers
/// keep a sum in memory otherwise, and everything waits for it.
constexpr int vectors_beside(int channels, int rows) {
  const int free = registers - (channels == 1 ? 3 : in_registers ? 1 : 2);
  return std::min(6, free / (channels * rows + 1));
}

/// What a block reads: plane[k] (weights kz[k]) and in it row[i], of each channel.
template <class T>
struct Window {
  const T* data;
  int64_t channel, channels;  // from one to the next, and how many
  int64_t planes, plane[3], kz[3];
  int64_t row[max_rows + 2];  // or -1: outside the image
  int64_t column[3];
  int64_t kernel;  // weights of a channel: taps x 3
};

/// Where a block's results go.
template <class T>
struct Target {
  T* out;                // the first row of the block's first channel
  int64_t plane, width;  // from a channel to the next; of the image
  const T* bias;         // or nullptr
  bool relu;
  const T* positive;  // of out's layout, or nullptr: results where this is not positive become 0
};

/// CO output channels x R rows x V vectors at columns x, x + lanes, ..., `last`. edge: columns -1 or W of the window's
/// rows, which do not exist, may be among the taps.
/// weight: [channel][kz][ky][kx][CO]
template <class T, int CO, int R, int V, bool edge>
void block(const Window<T>& window, int64_t x, int64_t last, const T* weight, const Target<T>& target) {
  constexpr int L = lanes<T>;
  vec<T> sum[R][CO][V];
#pragma GCC unroll 8
  for (int r = 0; r < R; ++r) {
#pragma GCC unroll 8
    for (int o = 0; o < CO; ++o) {
#pragma GCC unroll 8
      for (int v = 0; v < V; ++v) sum[r][o][v] = splat(target.bias == nullptr ? T(0) : target.bias[o]);
    }
  }
  // Elements that a vector load may read: at the ends of a row one less than all.
  const LaneRange<T> after_left(edge && x == 0 ? 1 : 0, L),
      before_right(0, edge && last + L >= target.width ? L - 1 : L);
  for (int64_t c = 0; c < window.channels; ++c) {
    for (int64_t k = 0; k < window.planes; ++k) {
      const T* plane = window.data + c * window.channel + window.plane[k] + x;
      const T* w = weight + (c * window.kernel + window.kz[k] * 9) * CO;
#pragma GCC unroll 3
      for (int kx = 0; kx < 3; ++kx) {
        vec<T> column[3];  // of weights, if there is one channel: for all rows
        if constexpr (CO == 1) {
#pragma GCC unroll 3
          for (int ky = 0; ky < 3; ++ky) column[ky] = splat(w[ky * 3 + kx]);
        }
#pragma GCC unroll 8
        for (int i = 0; i < R + 2; ++i) {
          if (window.row[i] < 0) continue;
          const T* from = plane + window.row[i] + window.column[kx];
          read_after(from, sum[0][0][0]);
          vec<T> pixels[V];
#pragma GCC unroll 8
          for (int v = 0; v < V; ++v) {
            if (kx == 0 && v * L * sizeof(T) % 64 == 0) __builtin_prefetch(from + (v + 2 * V) * L);  // two blocks on
            const T* at = from + (v == V - 1 ? last - x : v * L);
            if (edge && v == 0 && kx == 0) {
              pixels[v] = load(at, after_left);
            } else if (edge && v == V - 1 && kx == 2) {
              pixels[v] = load(at, before_right);
            } else {
              pixels[v] = load(at);
            }
          }
#pragma GCC unroll 8
          for (int r = 0; r < R; ++r) {
            if (r > i || r + 2 < i) continue;
            if constexpr (CO == 1) {
#pragma GCC unroll 8
              for (int v = 0; v < V; ++v) add_product<T>(sum[r][0][v], column[i - r], pixels[v]);
            } else {
              add_products<T>(sum[r], w, ((i - r) * 3 + kx) * CO, pixels);
            }
          }
        }
      }
    }
  }
  // Read once: for all that the compiler knows, the stores below change `target`.
  const auto [out, plane, width, bias, relu, positive] = target;
  const vec<T> lowest = splat(relu ? T(0) : -std::numeric_limits<T>::infinity());
  const int64_t size = V == 1 ? std::min<int64_t>(width, L) : L;
#pragma GCC unroll 8
  for (int r = 0; r < R; ++r) {
#pragma GCC unroll 8
    for (int o = 0; o < CO; ++o) {
#pragma GCC unroll 8
      for (int v = 0; v < V; ++v) {
        vec<T> value = sum[r][o][v] < lowest ? lowest : sum[r][o][v];  // keeps NaN
        const int64_t at = o * plane + r * width + (v == V - 1 ? last : x + v * L);
        if (positive != nullptr) {
          vec<T> before{};
          std::memcpy(&before, positive + at, size * sizeof(T));
          value = before > vec<T>{} ? value : vec<T>{};
        }
        if (size < L) {
          std::memcpy(out + at, &value, size * sizeof(T));
        } else {
          store(out + at, value);
        }
      }
    }
  }
}

template <class T>
using Block = void (*)(const Window<T>&, int64_t, int64_t, const T*, const Target<T>&);

template <class T, int CO, int R, int... V>
Block<T> pick(int64_t vectors, bool edge, std::integer_sequence<int, V...>) {
  static constexpr Block<T> at_edge[] = {block<T, CO, R, V + 1, true>...};
  static constexpr Block<T> inside[] = {block<T, CO, R, V + 1, false>...};
  return (edge ? at_edge : inside)[vectors - 1];
}
template <class T, int CO>
Block<T> pick(int64_t rows, int64_t vectors, bool edge) {
  constexpr int R = rows_beside(CO);
  if (rows == 1) return pick<T, CO, 1>(vectors, edge, std::make_integer_sequence<int, vectors_beside(CO, 1)>{});
  return pick<T, CO, R>(vectors, edge, std::make_integer_sequence<int, vectors_beside(CO, R)>{});
}
template <class T>
Block<T> pick(int64_t channels, int64_t rows, int64_t vectors, bool edge) {
  if constexpr (max_channels >= 8) {
    if (channels == 8) return pick<T, 8>(rows, vectors, edge);
  }
  return channels == 1   ? pick<T, 1>(rows, vectors, edge)
         : channels == 2 ? pick<T, 2>(rows, vectors, edge)
                         : pick<T, 4>(rows, vectors, edge);
}

/// How many of the channels from `o` on make the next block: 8 (if `largest` allows), 4, 2 or 1.
int64_t block_at(int64_t o, int64_t channels, int64_t largest) {
  while (largest > channels - o) largest /= 2;
  return largest;
}

/// [block of output channels][in_channels][tap][kx][channel of the block], each read from weight(o, c, tap and kx)
template <class T, class Weight>
Vector<T> pack(const Geometry& g, const Weight& weight) {
  Vector<T> packed(g.out_channels * g.in_channels * g.taps() * 3);
  T* to = packed.data();
  for (int64_t o = 0, size; o < g.out_channels; o += size) {
    size = block_at(o, g.out_channels, max_channels);
    for (int64_t c = 0; c < g.in_channels; ++c) {
      for (int64_t t = 0; t < g.taps() * 3; ++t) {
        for (int64_t i = 0; i < size; ++i) *to++ = weight(o + i, c, t);
      }
    }
  }
  return packed;
}

template <class T>
void convolve_rows(const Geometry& g, const Source<T>& source, const Vector<T>& weights, const T* bias, bool relu,
                   const T* positive, T* out, int threads) {
  const int64_t vectors = vectors_in<T>(g.out_width), groups = (g.out_height + max_rows - 1) / max_rows;
  // Planes that stay in a core's cache until the next one needs them go one by one, else rows through all planes.
  constexpr int64_t cache = 512 << 10;
  const bool by_row = g.kernel_depth * g.in_channels * g.in_height * source.pitch * int64_t{sizeof(T)} > cache;
  parallel_for(g.batch * g.out_depth * groups, threads, [&](int64_t unit) {
    const int64_t row = by_row ? unit / g.out_depth % groups : unit % groups, n = unit / groups / g.out_depth;
    const int64_t begin = row * max_rows, end = std::min(begin + max_rows, g.out_height);
    const int64_t z = by_row ? unit % g.out_depth : unit / groups % g.out_depth;
    Window<T> window;
    window.channel = g.in_rows() * source.pitch, window.channels = g.in_channels;
    window.data = source.data + n * g.in_channels * window.channel;
    window.kernel = g.taps() * 3, window.planes = 0;
    std::copy_n(source.column, 3, window.column);
    for (int64_t kz = 0; kz < g.kernel_depth; ++kz) {
      const int64_t plane = g.plane(z, kz);
      if (plane < 0) continue;
      window.plane[window.planes] = plane * g.in_height * source.pitch;
      window.kz[window.planes++] = kz;
    }
    Target<T> target{nullptr, g.out_rows() * g.out_width, g.out_width, nullptr, relu, nullptr};
    for (int64_t o = 0, size; o < g.out_channels; o += size) {
      size = block_at(o, g.out_channels, max_channels);
      target.bias = bias == nullptr ? nullptr : bias + o;
      const int64_t tall = rows_beside(static_cast<int>(size));
      const int64_t rows = g.stride == 1 && g.dilation == 1 && g.out_height >= tall ? tall : 1;
      const int64_t most = vectors_beside(static_cast<int>(size), static_cast<int>(rows)),
                    runs = (vectors + most - 1) / most;
      for (int64_t top = begin; top < end; top += rows) {
        const int64_t y = std::min(top, g.out_height - rows);  // the last rows of an image may be computed twice
        for (int64_t i = 0; i < rows + 2; ++i) {
          const int64_t row = g.row(y + (i > 2 ? i - 2 : 0), i > 2 ? 2 : i);
          window.row[i] = row < 0 ? -1 : row * source.pitch;
        }
        const int64_t at = (n * g.out_channels + o) * target.plane + (z * g.out_height + y) * g.out_width;
        target.out = out + at;
        if (positive != nullptr) target.positive = positive + at;
        for (int64_t run = 0; run < runs; ++run) {
          const int64_t first = vectors * run / runs, next = vectors * (run + 1) / runs;
          const int64_t x = vector_start<T>(first, g.out_width), last = vector_start<T>(next - 1, g.out_width);
          const bool edge = !source.padded && (run == 0 || run == runs - 1);
          pick<T>(size, rows, next - first, edge)(window, x, last, weights.data() + o * g.in_channels * window.kernel,
                                                  target);
        }
      }
    }
  });
}

}  // namespace
}  // namespace anynet::ANYNET_ISA
