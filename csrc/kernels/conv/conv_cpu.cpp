// One kernel does the forward pass and the gradient of the input: a block of output channels x a run of pixel vectors
// of one output row stays in registers while the rows that it reads go by (`block`). Output rows are independent, so
// the threads share them. The gradient of the weights keeps the three taps of a kernel row in registers instead and
// lets all pixels go by (`correlate`); chunks of rows that depend on the shape alone are summed apart and then in
// order, so that results repeat bit for bit.
//
// Rows are read where they are. The last vector of a row ends where the row ends, and computes some pixels of the
// vector before it again; columns -1 and W are zeros shifted into the first and last vector. Only what this cannot
// express is first copied to padded rows (`Source`): stride 2, the affine and ReLU of the input, and rows shorter than
// a vector.
#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "../common/parallel.h"
#include "../common/simd.h"
#include "conv.h"

namespace anynet::ANYNET_ISA {
namespace {

// Registers that accumulate: 4 channels x this many vectors, which leaves room for a tap's pixels and a weight.
constexpr int block_vectors = vector_bytes == 64 ? 5 : vector_bytes == 32 ? 3 : 2;
constexpr int max_taps = 9;     // (kz, ky); kx is not counted
constexpr int64_t chunks = 64;  // about as many partial sums of the weights' gradient

template <class T>
using lane_sequence = std::make_integer_sequence<int, lanes<T>>;

/// {0, v[0], v[1], ...}
template <class T, int... I>
ANYNET_INLINE vec<T> shift_up(vec<T> v, std::integer_sequence<int, I...>) {
  return __builtin_shufflevector(v, vec<T>{}, (I == 0 ? lanes<T> : I - 1)...);
}
/// {v[1], v[2], ..., 0}
template <class T, int... I>
ANYNET_INLINE vec<T> shift_down(vec<T> v, std::integer_sequence<int, I...>) {
  return __builtin_shufflevector(v, vec<T>{}, (I + 1)...);
}

/// How many vectors cover a row, the last one moved back to end where the row ends.
template <class T>
int64_t vectors_in(int64_t width) {
  return (width + lanes<T> - 1) / lanes<T>;
}
template <class T>
int64_t vector_start(int64_t index, int64_t width) {
  return std::max<int64_t>(0, std::min<int64_t>(index * lanes<T>, width - lanes<T>));
}

/// A tensor's rows as the kernels read them: output column x sees through kx the element column[kx] + x of a row.
template <class T>
struct Source {
  const T* data;
  int64_t pitch;  // from a row to the next
  int64_t column[3];
  bool padded;  // false: the tensor itself, in which columns -1 and W do not exist
  std::vector<T> copy;

  /// The tensor itself.
  Source(const T* tensor, int64_t width) : data(tensor), pitch(width), column{-1, 0, 1}, padded(false) {}

  /// activate(row)(element) of each element, for rows of `reach` output columns. With stride 2 the odd columns come
  /// first, then the even ones; with dilation 2 there are zeros between the elements.
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
      const auto f = activate(r);
      if (stride == 2) {
        for (int64_t x = 1; x < width; x += 2) to[1 + x / 2] = f(from[x]);
        for (int64_t x = 0; x < width; x += 2) to[half + x / 2] = f(from[x]);
      } else {
        for (int64_t x = 0; x < width; ++x) to[1 + x * dilation] = f(from[x]);
      }
    });
  }
};

template <class T>
constexpr auto identity = [](int64_t) { return [](T v) { return v; }; };

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
  int64_t taps() const { return 3 * kernel_depth; }
  int64_t in_rows() const { return in_depth * in_height; }
  int64_t out_rows() const { return out_depth * out_height; }

  /// The row of an input channel's that output row (z, y) reads through (kz, ky), or -1.
  int64_t row(int64_t z, int64_t y, int64_t kz, int64_t ky) const {
    const int64_t iz = kernel_depth == 1 ? z * dilation : z * stride + kz - 1, iy = y * stride + ky - 1;
    if (iz < 0 || iy < 0 || iz % dilation != 0 || iy % dilation != 0) return -1;
    if (iz / dilation >= in_depth || iy / dilation >= in_height) return -1;
    return iz / dilation * in_height + iy / dilation;
  }
};

// --------------------------------------------------------------------------------- forward and gradient of the input

/// What one output row reads: for channel c and tap j the row at data + c * channel + source[j].
template <class T>
struct Rows {
  const T* data;
  int64_t channel, channels, taps;
  int count;                 // taps inside the image
  int64_t source[max_taps];  // where each one's row starts
  int64_t weight[max_taps];  // and which (kz, ky) it is
  int64_t column[3];
  bool left, right;  // columns -1 and W must be made up
};

/// Where a block's results go.
template <class T>
struct Target {
  T* out;         // the row of the block's first channel
  int64_t plane;  // from a channel to the next
  int64_t width;
  const T* bias;  // or nullptr
  bool relu;
};

/// CO output channels x V vectors of one output row, at columns x, x + lanes, ..., `last`.
/// weight: [channel][tap][kx][CO]
template <class T, int CO, int V>
void block(const Rows<T>& rows, int64_t x, int64_t last, const T* weight, const Target<T>& target) {
  vec<T> sum[CO][V];
#pragma GCC unroll 8
  for (int o = 0; o < CO; ++o) {
#pragma GCC unroll 8
    for (int v = 0; v < V; ++v) sum[o][v] = splat(target.bias == nullptr ? T(0) : target.bias[o]);
  }
  const bool left = rows.left && x == 0, right = rows.right && last + lanes<T> == target.width;
  for (int64_t c = 0; c < rows.channels; ++c) {
    for (int j = 0; j < rows.count; ++j) {
      const T* row = rows.data + c * rows.channel + rows.source[j];
      const T* w = weight + (c * rows.taps + rows.weight[j]) * 3 * CO;
#pragma GCC unroll 3
      for (int kx = 0; kx < 3; ++kx) {
        vec<T> pixels[V];
#pragma GCC unroll 8
        for (int v = 0; v < V; ++v) {
          const int64_t at = v == V - 1 ? last : x + v * lanes<T>;
          if (v == 0 && kx == 0 && left) {
            pixels[v] = shift_up<T>(load(row + at), lane_sequence<T>{});
          } else if (v == V - 1 && kx == 2 && right) {
            pixels[v] = shift_down<T>(load(row + at), lane_sequence<T>{});
          } else {
            pixels[v] = load(row + rows.column[kx] + at);
          }
        }
#pragma GCC unroll 8
        for (int o = 0; o < CO; ++o) {
          const vec<T> wo = splat(w[kx * CO + o]);
#pragma GCC unroll 8
          for (int v = 0; v < V; ++v) sum[o][v] += wo * pixels[v];
        }
      }
    }
  }
#pragma GCC unroll 8
  for (int o = 0; o < CO; ++o) {
#pragma GCC unroll 8
    for (int v = 0; v < V; ++v) {
      const vec<T> value = target.relu ? (sum[o][v] < vec<T>{} ? vec<T>{} : sum[o][v]) : sum[o][v];
      T* out = target.out + o * target.plane + (v == V - 1 ? last : x + v * lanes<T>);
      if (target.width < lanes<T>) {
        std::memcpy(out, &value, target.width * sizeof(T));
      } else {
        store(out, value);
      }
    }
  }
}

template <class T>
using Block = void (*)(const Rows<T>&, int64_t, int64_t, const T*, const Target<T>&);

template <class T, int CO, int... V>
Block<T> pick(int64_t vectors, std::integer_sequence<int, V...>) {
  static constexpr Block<T> blocks[] = {block<T, CO, V + 1>...};
  return blocks[vectors - 1];
}

template <class T>
Block<T> pick(int64_t channels, int64_t vectors) {
  constexpr auto counts = std::make_integer_sequence<int, block_vectors>{};
  return channels == 1   ? pick<T, 1>(vectors, counts)
         : channels == 2 ? pick<T, 2>(vectors, counts)
                         : pick<T, 4>(vectors, counts);
}

/// How many of the channels from `o` on make the next block: 8 (if `largest` allows), 4, 2 or 1.
int64_t block_at(int64_t o, int64_t channels, int64_t largest) {
  while (largest > channels - o) largest /= 2;
  return largest;
}

/// [block of output channels][in_channels][tap][kx][channel of the block], each read from weight(o, c, tap and kx)
template <class T, class Weight>
std::vector<T> pack(const Geometry& g, const Weight& weight) {
  std::vector<T> packed;
  packed.reserve(g.out_channels * g.in_channels * g.taps() * 3);
  for (int64_t o = 0, size; o < g.out_channels; o += size) {
    size = block_at(o, g.out_channels, 4);
    for (int64_t c = 0; c < g.in_channels; ++c) {
      for (int64_t t = 0; t < g.taps() * 3; ++t) {
        for (int64_t i = 0; i < size; ++i) packed.push_back(weight(o + i, c, t));
      }
    }
  }
  return packed;
}

template <class T>
void convolve(const Geometry& g, const Source<T>& source, const std::vector<T>& weights, const T* bias, bool relu,
              T* out, int threads) {
  const int64_t vectors = vectors_in<T>(g.out_width), runs = (vectors + block_vectors - 1) / block_vectors;
  parallel_for(g.batch * g.out_rows(), threads, [&](int64_t r) {
    const int64_t y = r % g.out_height, z = r / g.out_height % g.out_depth, n = r / g.out_rows();
    Rows<T> rows;
    rows.channel = g.in_rows() * source.pitch;
    rows.data = source.data + n * g.in_channels * rows.channel;
    rows.channels = g.in_channels, rows.taps = g.taps(), rows.count = 0;
    for (int64_t t = 0; t < g.taps(); ++t) {
      const int64_t row = g.row(z, y, t / 3, t % 3);
      if (row >= 0) rows.source[rows.count] = row * source.pitch, rows.weight[rows.count++] = t;
    }
    std::copy_n(source.column, 3, rows.column);
    rows.left = rows.right = !source.padded;

    Target<T> target{nullptr, g.out_rows() * g.out_width, g.out_width, nullptr, relu};
    T* row = out + n * g.out_channels * target.plane + (z * g.out_height + y) * g.out_width;
    for (int64_t run = 0; run < runs; ++run) {
      const int64_t first = vectors * run / runs, end = vectors * (run + 1) / runs;
      const int64_t x = vector_start<T>(first, g.out_width), last = vector_start<T>(end - 1, g.out_width);
      for (int64_t o = 0, size; o < g.out_channels; o += size) {
        size = block_at(o, g.out_channels, 4);
        target.out = row + o * target.plane;
        target.bias = bias == nullptr ? nullptr : bias + o;
        pick<T>(size, end - first)(rows, x, last, weights.data() + o * g.in_channels * g.taps() * 3, target);
      }
    }
  });
}

// --------------------------------------------------------------------------------------------- gradient of the weights

template <class T>
T sum_lanes(vec<T> v) {
  T sum = 0;
  for (int i = 0; i < lanes<T>; ++i) sum += v[i];
  return sum;
}

/// Output rows [begin, end) of planes (n, z) [first, last).
struct Chunk {
  int64_t first, last, begin, end;
};

/// sums[o * stride + kx] = the sum over a chunk of grad[o] times the input that it saw through (kz, ky) and kx.
template <class T, int CO>
void correlate(const Geometry& g, const Source<T>& input, const Source<T>& grad, vec<T> tail, const Chunk& chunk,
               int64_t o, int64_t c, int64_t kz, int64_t ky, int64_t stride, T* sums) {
  const int64_t plane = g.out_rows() * grad.pitch, last = vector_start<T>(vectors_in<T>(g.out_width) - 1, g.out_width);
  const int64_t center = grad.padded ? grad.column[1] : 0;
  vec<T> sum[CO][3] = {};
  for (int64_t p = chunk.first; p < chunk.last; ++p) {
    const int64_t n = p / g.out_depth, z = p % g.out_depth;
    for (int64_t y = chunk.begin; y < chunk.end; ++y) {
      const int64_t r = g.row(z, y, kz, ky);
      if (r < 0) continue;
      const T* row = input.data + ((n * g.in_channels + c) * g.in_rows() + r) * input.pitch;
      const T* to = grad.data + (n * g.out_channels + o) * plane + (z * g.out_height + y) * grad.pitch + center;
      const auto step = [&](int64_t x, bool left, bool right) __attribute__((always_inline)) {
        vec<T> pixels[3];
        pixels[0] = left ? shift_up<T>(load(row + x), lane_sequence<T>{}) : load(row + input.column[0] + x);
        pixels[1] = load(row + input.column[1] + x);
        pixels[2] = right ? shift_down<T>(load(row + x), lane_sequence<T>{}) : load(row + input.column[2] + x);
#pragma GCC unroll 8
        for (int i = 0; i < CO; ++i) {
          vec<T> v = load(to + i * plane + x);
          if (x == last)
            v = reinterpret_cast<vec<T>>(reinterpret_cast<typename Simd<T>::mask>(v) &
                                         reinterpret_cast<typename Simd<T>::mask>(tail));
#pragma GCC unroll 3
          for (int kx = 0; kx < 3; ++kx) sum[i][kx] += v * pixels[kx];
        }
      };
      if (last > 0) step(0, !input.padded, false);
      for (int64_t x = lanes<T>; x < last; x += lanes<T>) step(x, false, false);
      step(last, !input.padded && last == 0, !input.padded);
    }
  }
  for (int i = 0; i < CO; ++i) {
    for (int kx = 0; kx < 3; ++kx) sums[i * stride + kx] = sum_lanes<T>(sum[i][kx]);
  }
}

}  // namespace

template <class T>
void conv(const Conv<T>& a, int threads) {
  const Geometry g(a.shape);
  const int64_t size = g.in_channels * g.taps() * 3, depth = g.taps() * 3;
  const auto weights = pack<T>(g, [&](int64_t o, int64_t c, int64_t t) { return a.weight[o * size + c * depth + t]; });
  const bool direct = g.stride == 1 && a.scale == nullptr && !a.relu_in && g.out_width >= lanes<T>;
  const auto activate = [&](int64_t row) {
    const int64_t c = row / g.in_rows() % g.in_channels;
    const T scale = a.scale == nullptr ? T(1) : a.scale[c], shift = a.scale == nullptr ? T(0) : a.shift[c];
    const T lowest = a.relu_in ? T(0) : -std::numeric_limits<T>::infinity();
    return [=](T v) {
      v = scale * v + shift;
      return v < lowest ? lowest : v;  // keeps NaN
    };
  };
  const Source<T> source = direct ? Source<T>(a.input, g.in_width)
                                  : Source<T>(a.input, g.batch * g.in_channels * g.in_rows(), g.in_width, g.out_width,
                                              g.stride, 1, threads, activate);
  convolve(g, source, weights, a.bias, a.relu_out, a.out, threads);
}

template <class T>
void conv_backward_input(const ConvBackwardInput<T>& a, int threads) {
  const Geometry g = Geometry(a.shape).backward();
  const int64_t size = g.out_channels * g.taps() * 3, depth = g.taps() * 3;
  const auto weights =
      pack<T>(g, [&](int64_t c, int64_t o, int64_t t) { return a.weight[o * size + c * depth + depth - 1 - t]; });
  const bool direct = g.dilation == 1 && g.out_width >= lanes<T>;
  const Source<T> source = direct ? Source<T>(a.grad, g.in_width)
                                  : Source<T>(a.grad, g.batch * g.in_channels * g.in_rows(), g.in_width, g.out_width, 1,
                                              g.dilation, threads, identity<T>);
  convolve(g, source, weights, static_cast<const T*>(nullptr), false, a.grad_input, threads);
}

template <class T>
void conv_backward_weight(const ConvBackwardWeight<T>& a, int threads) {
  const Geometry g(a.shape);
  const int64_t W = g.out_width, depth = g.taps() * 3, size = g.in_channels * depth;
  const Source<T> input = g.stride == 1 && W >= lanes<T> ? Source<T>(a.input, g.in_width)
                                                         : Source<T>(a.input, g.batch * g.in_channels * g.in_rows(),
                                                                     g.in_width, W, g.stride, 1, threads, identity<T>);
  const Source<T> grad =
      W >= lanes<T> ? Source<T>(a.grad, W)
                    : Source<T>(a.grad, g.batch * g.out_channels * g.out_rows(), W, W, 1, 1, threads, identity<T>);
  // Which lanes of a row's last vector the one before it has not seen.
  typename Simd<T>::mask lane{};
  for (int i = 0; i < lanes<T>; ++i) lane[i] = W < lanes<T> || i >= vectors_in<T>(W) * lanes<T> - W ? -1 : 0;
  const vec<T> tail = reinterpret_cast<vec<T>>(lane);

  const int64_t planes = g.batch * g.out_depth;
  const int64_t groups = std::min(planes, chunks);
  const int64_t parts = planes == 0 ? 0 : std::max<int64_t>(1, std::min(g.out_height, chunks / planes));
  const int64_t count = groups * parts, total = g.out_channels * (size + 1);
  std::vector<T> partial(count * total);  // per chunk [O][C][tap][kx], then the bias' [O]
  parallel_for(count, threads, [&](int64_t i) {
    const int64_t group = i / parts, part = i % parts;
    const Chunk chunk{planes * group / groups, planes * (group + 1) / groups, g.out_height * part / parts,
                      g.out_height * (part + 1) / parts};
    T* sums = partial.data() + i * total;
    for (int64_t o = 0, step; o < g.out_channels; o += step) {
      step = block_at(o, g.out_channels, vector_bytes == 64 ? 8 : 4);
      const auto kernel = step == 8   ? correlate<T, 8>
                          : step == 4 ? correlate<T, 4>
                          : step == 2 ? correlate<T, 2>
                                      : correlate<T, 1>;
      for (int64_t c = 0; c < g.in_channels; ++c) {
        for (int64_t t = 0; t < g.taps(); ++t) {
          kernel(g, input, grad, tail, chunk, o, c, t / 3, t % 3, size, sums + o * size + c * depth + t * 3);
        }
      }
    }
    if (a.grad_bias == nullptr) return;
    for (int64_t o = 0; o < g.out_channels; ++o) {
      T sum = 0;
      for (int64_t p = chunk.first; p < chunk.last; ++p) {
        const int64_t n = p / g.out_depth, z = p % g.out_depth;
        const T* row = a.grad + ((n * g.out_channels + o) * g.out_rows() + z * g.out_height) * W;
        for (int64_t k = chunk.begin * W; k < chunk.end * W; ++k) sum += row[k];
      }
      sums[g.out_channels * size + o] = sum;
    }
  });
  parallel_for(g.out_channels, threads, [&](int64_t o) {
    T* to = a.grad_weight + o * size;
    std::fill_n(to, size, T(0));
    if (a.grad_bias != nullptr) a.grad_bias[o] = 0;
    for (int64_t i = 0; i < count; ++i) {
      const T* from = partial.data() + i * total;
      for (int64_t k = 0; k < size; ++k) to[k] += from[o * size + k];
      if (a.grad_bias != nullptr) a.grad_bias[o] += from[g.out_channels * size + o];
    }
  });
}

#define ANYNET_INSTANTIATE_CONV(T)                                        \
  template void conv<T>(const Conv<T>&, int);                             \
  template void conv_backward_input<T>(const ConvBackwardInput<T>&, int); \
  template void conv_backward_weight<T>(const ConvBackwardWeight<T>&, int);

ANYNET_INSTANTIATE_CONV(float)
ANYNET_INSTANTIATE_CONV(double)

}  // namespace anynet::ANYNET_ISA
