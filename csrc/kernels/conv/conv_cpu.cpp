// One convolution is the forward pass and the gradient of the input: `direct.h`, or `winograd.h` for layers with enough
// channels. The gradient of the weights keeps the three taps of a kernel row in registers instead and lets all pixels
// go by (`correlate`); chunks of rows that depend on the shape alone are summed apart and then in order, so that
// results repeat bit for bit.
#include <algorithm>
#include <limits>
#include <type_traits>

#include "conv.h"
#include "direct.h"
#include "winograd.h"

namespace anynet::ANYNET_ISA {
namespace {

template <class T>
constexpr auto identity = [](int64_t) { return [](auto v) { return v; }; };

/// What `a` (Conv or ConvBackwardWeight) does to the elements of each row of its input before it convolves them.
template <class T, class Args>
auto activation(const Args& a) {
  const int64_t rows = a.shape.depth * a.shape.height, channels = a.shape.in_channels;
  const T lowest = a.relu_in ? T(0) : -std::numeric_limits<T>::infinity();
  return [=](int64_t row) {
    const int64_t c = row / rows % channels;
    const T scale = a.scale == nullptr ? T(1) : a.scale[c], shift = a.scale == nullptr ? T(0) : a.shift[c];
    return [=](auto v) {  // an element or a vector of them; keeps NaN
      v = scale * v + shift;
      if constexpr (std::is_same_v<decltype(v), T>) {
        return v < lowest ? lowest : v;
      } else {
        return max<T>(splat(lowest), v);
      }
    };
  };
}

/// The convolution with weight(o, c, tap and kx), by the faster algorithm. See `Target` for the rest.
template <class T, class Weight>
void convolve(const Geometry& g, const Source<T>& source, const Weight& weight, const T* bias, bool relu,
              const T* positive, T* out, int threads) {
  const auto by_tiles = [&](auto over) {
    const auto packed = pack_transformed<T, over()>(g, weight);
    if constexpr (over() == Over::height) {
      convolve_heights(g, source, packed, bias, relu, positive, out, threads);
    } else {
      convolve_tiles<T, over()>(g, source, packed, bias, relu, positive, out, threads);
    }
  };
  if (Tiling<T, Over::depth_and_height>::pays(g)) {
    by_tiles(std::integral_constant<Over, Over::depth_and_height>{});
  } else if (Tiling<T, Over::height_and_width>::pays(g)) {
    by_tiles(std::integral_constant<Over, Over::height_and_width>{});
  } else if (Tiling<T, Over::height>::pays(g)) {
    by_tiles(std::integral_constant<Over, Over::height>{});
  } else {
    convolve_rows(g, source, pack<T>(g, weight), bias, relu, positive, out, threads);
  }
}

// --------------------------------------------------------------------------------------------- gradient of the weights

constexpr int64_t most_chunks = 64;     // that are summed apart
constexpr int64_t chunk_vectors = 128;  // of gradient in a chunk, at least

template <int distance, class T, int... I>
ANYNET_INLINE vec<T> rotate(vec<T> v, std::integer_sequence<int, I...>) {
  return shuffle<((I + distance) % lanes<T>)...>(v, v);
}
template <class T, int distance = lanes<T> / 2>
ANYNET_INLINE T sum_lanes(vec<T> v) {
  if constexpr (distance == 0) {
    return v[0];
  } else {
    return sum_lanes<T, distance / 2>(v + rotate<distance, T>(v, lane_sequence<T>{}));
  }
}

/// Output rows [begin, end) of planes (n, z) [first, last).
struct Chunk {
  int64_t first, last, begin, end;
};

/// Adds a vector of gradients of CO channels times the pixels of CI channels that they saw through each kx.
template <class T, int CO, int CI, class Left, class Right, class Fresh>
ANYNET_INLINE void add_columns(vec<T> (&sum)[CO][CI][3], const T* in, int64_t in_channel, const int64_t* column,
                               const T* out, int64_t out_channel, Left left, Right right, Fresh fresh) {
  // Whichever is fewer stays in registers: three columns of one input channel, or the gradients.
  if constexpr (CI == 1) {
    const vec<T> pixels[3] = {load(in + column[0], left), load(in + column[1]), load(in + column[2], right)};
#pragma GCC unroll 8
    for (int k = 0; k < CO; ++k) {
      const vec<T> gradient = load(out + k * out_channel, fresh);
#pragma GCC unroll 3
      for (int kx = 0; kx < 3; ++kx) add_product<T>(sum[k][0][kx], gradient, pixels[kx]);
      read_after(out, sum[k][0][2]);
    }
  } else {
    vec<T> gradients[CO];
#pragma GCC unroll 8
    for (int k = 0; k < CO; ++k) gradients[k] = load(out + k * out_channel, fresh);
#pragma GCC unroll 8
    for (int i = 0; i < CI; ++i) {
#pragma GCC unroll 3
      for (int kx = 0; kx < 3; ++kx) {
        const T* at = in + i * in_channel + column[kx];
        const vec<T> pixels = kx == 0 ? load(at, left) : kx == 1 ? load(at) : load(at, right);
#pragma GCC unroll 8
        for (int k = 0; k < CO; ++k) add_product<T>(sum[k][i][kx], gradients[k], pixels);
        read_after(in, sum[CO - 1][i][kx]);
      }
    }
  }
}

/// sums[o * out_step + c * in_step + kx] += the sum over a chunk of grad[o] times the input c that it saw through
/// (kz, ky) and kx, for CO output and CI input channels from `o` and `c` on. Each sum is still a vector of sums.
template <class T, int CO, int CI>
void correlate(const Geometry& g, const Source<T>& input, const Source<T>& grad, const Chunk& chunk, int64_t o,
               int64_t c, int64_t kz, int64_t ky, int64_t out_step, int64_t in_step, T* sums) {
  constexpr int L = lanes<T>;
  const int64_t last = vector_start<T>(vectors_in<T>(g.out_width) - 1, g.out_width);
  const int64_t out_channel = g.out_rows() * grad.pitch, in_channel = g.in_rows() * input.pitch;
  const T* from = input.data + c * in_channel;
  const T* to = grad.data + o * out_channel + (grad.padded ? grad.column[1] : 0);
  const LaneRange<T> all(0, L), left(input.padded ? 0 : 1, L), right(0, input.padded ? L : L - 1);
  const LaneRange<T> fresh(grad.padded ? 0 : (L - g.out_width % L) % L, L);  // what the vector before has not seen
  // The rows for which the tap lies inside the input.
  const int64_t begin = std::max<int64_t>(chunk.begin, ky == 0);
  const int64_t end = std::min(chunk.end, (g.in_height - ky + g.stride) / g.stride);
  vec<T> sum[CO][CI][3] = {};
  for (int64_t p = chunk.first; p < chunk.last; ++p) {
    const int64_t n = p / g.out_depth, z = p % g.out_depth, iz = g.plane(z, kz);
    if (iz < 0) continue;
    const T* in_plane = from + n * g.in_channels * in_channel + iz * g.in_height * input.pitch;
    const T* out_plane = to + n * g.out_channels * out_channel + z * g.out_height * grad.pitch;
    for (int64_t y = begin; y < end; ++y) {
      const T* row = in_plane + (y * g.stride + ky - 1) * input.pitch;
      const T* out_row = out_plane + y * grad.pitch;
      const auto step = [&](int64_t x, auto left, auto right, auto fresh) __attribute__((always_inline)) {
        add_columns<T, CO, CI>(sum, row + x, in_channel, input.column, out_row + x, out_channel, left, right, fresh);
      };
      if (last > 0) step(0, left, AllLanes{}, AllLanes{});
      for (int64_t x = L; x < last; x += L) step(x, AllLanes{}, AllLanes{}, AllLanes{});
      step(last, last == 0 ? left : all, right, fresh);
    }
  }
#pragma GCC unroll 8
  for (int k = 0; k < CO; ++k) {
#pragma GCC unroll 8
    for (int i = 0; i < CI; ++i) {
#pragma GCC unroll 3
      for (int kx = 0; kx < 3; ++kx) {
        T* to = sums + (k * out_step + i * in_step + kx) * L;
        store(to, load(to) + sum[k][i][kx]);
      }
    }
  }
}

template <class T>
using Correlate = decltype(&correlate<T, 1, 1>);

template <class T, int CO>
Correlate<T> pick_correlate(int64_t in) {
  constexpr int most = max_channels / CO;
  if constexpr (most >= 8) {
    if (in == 8) return correlate<T, CO, 8>;
  }
  if constexpr (most >= 4) {
    if (in == 4) return correlate<T, CO, 4>;
  }
  if constexpr (most >= 2) {
    if (in == 2) return correlate<T, CO, 2>;
  }
  return correlate<T, CO, 1>;
}
/// For blocks of so many channels; their product is at most max_channels.
template <class T>
Correlate<T> pick_correlate(int64_t out, int64_t in) {
  if constexpr (max_channels >= 8) {
    if (out == 8) return pick_correlate<T, 8>(in);
  }
  return out == 4 ? pick_correlate<T, 4>(in) : out == 2 ? pick_correlate<T, 2>(in) : pick_correlate<T, 1>(in);
}

/// sums[o][C][tap][kx], each a vector, over a chunk, for `out` channels from `o` on. In pieces whose rows stay in the
/// nearest cache.
template <class T>
void correlate_block(const Geometry& g, const Source<T>& input, const Source<T>& grad, const Chunk& chunk, int64_t o,
                     int64_t out, T* sums) {
  constexpr int64_t cache = 32 << 10;
  const int64_t fitting = std::max<int64_t>(1, cache / (grad.pitch * (max_channels + 1) * int64_t{sizeof(T)}));
  const int64_t height = std::max<int64_t>(1, chunk.end - chunk.begin);
  const int64_t depth = std::max<int64_t>(1, fitting / height);
  const int64_t taps = g.taps(), kernel = taps * 3, size = g.in_channels * kernel;
  for (int64_t first = chunk.first; first < chunk.last; first += depth) {
    for (int64_t begin = chunk.begin; begin < chunk.end; begin += fitting) {
      const Chunk piece{first, std::min(first + depth, chunk.last), begin, std::min(begin + fitting, chunk.end)};
      for (int64_t c = 0, in; c < g.in_channels; c += in) {
        in = block_at(c, g.in_channels, max_channels / out);
        const auto function = pick_correlate<T>(out, in);
        for (int64_t t = 0; t < taps; ++t) {
          function(g, input, grad, piece, o, c, t / 3, t % 3, size, kernel, sums + (c * kernel + t * 3) * lanes<T>);
        }
      }
    }
  }
}

/// The gradient of these images, added to what is there.
template <class T>
void add_weight_gradient(const ConvBackwardWeight<T>& a, const Geometry& g, bool direct, int threads) {
  const int64_t W = g.out_width, depth = g.taps() * 3, size = g.in_channels * depth;
  const Source<T> input = direct ? Source<T>(a.input, g.in_width)
                                 : Source<T>(a.input, g.batch * g.in_channels * g.in_rows(), g.in_width, W, g.stride, 1,
                                             threads, activation<T>(a));
  const Source<T> grad =
      W >= lanes<T> ? Source<T>(a.grad, W)
                    : Source<T>(a.grad, g.batch * g.out_channels * g.out_rows(), W, W, 1, 1, threads, identity<T>);
  const int64_t planes = g.batch * g.out_depth;
  const int64_t wanted = std::clamp<int64_t>(planes * g.out_height * vectors_in<T>(W) / chunk_vectors, 1, most_chunks);
  const int64_t groups = std::min(planes, wanted);
  const int64_t parts = planes == 0 ? 0 : std::max<int64_t>(1, std::min(g.out_height, wanted / planes));
  const int64_t count = groups * parts, total = g.out_channels * (size + 1);
  Vector<int64_t> blocks;  // of output channels: where they begin
  for (int64_t o = 0; o < g.out_channels; o += block_at(o, g.out_channels, max_channels)) blocks.push_back(o);
  const int64_t in_chunk = static_cast<int64_t>(blocks.size());
  Vector<T> partial(count * total, T(0));  // per chunk [O][C][tap][kx], then the bias' [O]
  parallel_for(count * in_chunk, threads, [&](int64_t unit) {
    const int64_t i = unit / in_chunk, group = i / parts, part = i % parts;
    const Chunk chunk{planes * group / groups, planes * (group + 1) / groups, g.out_height * part / parts,
                      g.out_height * (part + 1) / parts};
    T* sums = partial.data() + i * total;
    const int64_t first = blocks[unit % in_chunk], out = block_at(first, g.out_channels, max_channels);
    const Scratch<T> vectors(out * size * lanes<T>);
    fill_zero<T>(vectors, out * size * lanes<T>);
    correlate_block<T>(g, input, grad, chunk, first, out, vectors);
    for (int64_t k = 0; k < out * size; ++k) sums[first * size + k] = sum_lanes<T>(load(vectors + k * lanes<T>));
    if (a.grad_bias == nullptr) return;
    for (int64_t o = first; o < first + out; ++o) {
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
    for (int64_t i = 0; i < count; ++i) {
      const T* from = partial.data() + i * total;
      for (int64_t k = 0; k < size; ++k) to[k] += from[o * size + k];
      if (a.grad_bias != nullptr) a.grad_bias[o] += from[g.out_channels * size + o];
    }
  });
}

}  // namespace

template <class T>
void conv(const Conv<T>& a, int available) {
  const Geometry g(a.shape);
  const int threads = g.threads(available);
  const int64_t size = g.in_channels * g.taps() * 3, depth = g.taps() * 3;
  const auto weight = [&](int64_t o, int64_t c, int64_t t) { return a.weight[o * size + c * depth + t]; };
  const bool direct = a.scale == nullptr && !a.relu_in && g.stride == 1 && g.out_width >= lanes<T>;
  by_images(g.batch, direct ? 0 : g.in_size() * int64_t{sizeof(T)}, [&](int64_t n, int64_t images) {
    const T* input = a.input + n * g.in_size();
    const Source<T> source = direct ? Source<T>(input, g.in_width)
                                    : Source<T>(input, images * g.in_channels * g.in_rows(), g.in_width, g.out_width,
                                                g.stride, 1, threads, activation<T>(a));
    convolve(g.of(images), source, weight, a.bias, a.relu_out, static_cast<const T*>(nullptr), a.out + n * g.out_size(),
             threads);
  });
}

template <class T>
void conv_backward_input(const ConvBackwardInput<T>& a, int available) {
  const Geometry g = Geometry(a.shape).backward();
  const int threads = g.threads(available);
  const int64_t size = g.out_channels * g.taps() * 3, depth = g.taps() * 3;
  const auto weight = [&](int64_t c, int64_t o, int64_t t) { return a.weight[o * size + c * depth + depth - 1 - t]; };
  const bool direct = g.dilation == 1 && g.out_width >= lanes<T>;
  by_images(g.batch, direct ? 0 : g.dilation * g.in_size() * int64_t{sizeof(T)}, [&](int64_t n, int64_t images) {
    const T* grad = a.grad + n * g.in_size();
    const Source<T> source = direct ? Source<T>(grad, g.in_width)
                                    : Source<T>(grad, images * g.in_channels * g.in_rows(), g.in_width, g.out_width, 1,
                                                g.dilation, threads, identity<T>);
    convolve(g.of(images), source, weight, static_cast<const T*>(nullptr), false,
             a.before == nullptr ? nullptr : a.before + n * g.out_size(), a.grad_input + n * g.out_size(), threads);
  });
}

template <class T>
void conv_backward_weight(const ConvBackwardWeight<T>& a, int available) {
  const Geometry g(a.shape);
  std::fill_n(a.grad_weight, g.out_channels * g.in_channels * g.taps() * 3, T(0));
  if (a.grad_bias != nullptr) std::fill_n(a.grad_bias, g.out_channels, T(0));
  const bool direct = a.scale == nullptr && !a.relu_in && g.stride == 1 && g.out_width >= lanes<T>;
  by_images(g.batch, direct ? 0 : g.in_size() * int64_t{sizeof(T)}, [&](int64_t n, int64_t images) {
    ConvBackwardWeight<T> part = a;
    part.input += n * g.in_size(), part.grad += n * g.out_size();
    add_weight_gradient(part, g.of(images), direct, g.threads(available));
  });
}

#define ANYNET_INSTANTIATE_CONV(T)                                        \
  template void conv<T>(const Conv<T>&, int);                             \
  template void conv_backward_input<T>(const ConvBackwardInput<T>&, int); \
  template void conv_backward_weight<T>(const ConvBackwardWeight<T>&, int);

ANYNET_INSTANTIATE_CONV(float)
ANYNET_INSTANTIATE_CONV(double)

}  // namespace anynet::ANYNET_ISA
