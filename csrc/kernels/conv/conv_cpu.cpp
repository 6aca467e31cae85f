// One convolution is the forward pass and the gradient of the input: `direct.h`, or `winograd.h` for layers with enough
// channels. The gradient of the weights keeps the three taps of a kernel row in registers instead and lets all pixels
// go by (`correlate`); chunks of rows that depend on the shape alone are summed apart and then in order, so that
// results repeat bit for bit.
#include <algorithm>
#include <limits>

#include "conv.h"
#include "direct.h"
#include "winograd.h"

namespace anynet::ANYNET_ISA {
namespace {

template <class T>
constexpr auto identity = [](int64_t) { return [](T v) { return v; }; };

/// What `a` (Conv or ConvBackwardWeight) does to the elements of each row of its input before it convolves them.
template <class T, class Args>
auto activation(const Args& a) {
  const int64_t rows = a.shape.depth * a.shape.height, channels = a.shape.in_channels;
  const T lowest = a.relu_in ? T(0) : -std::numeric_limits<T>::infinity();
  return [=](int64_t row) {
    const int64_t c = row / rows % channels;
    const T scale = a.scale == nullptr ? T(1) : a.scale[c], shift = a.scale == nullptr ? T(0) : a.shift[c];
    return [=](T v) {
      v = scale * v + shift;
      return v < lowest ? lowest : v;  // keeps NaN
    };
  };
}

/// The convolution with weight(o, c, tap and kx), by the faster algorithm. See `Target` for the rest.
template <class T, class Weight>
void convolve(const Geometry& g, const Source<T>& source, const Weight& weight, const T* bias, bool relu,
              const T* positive, T* out, int threads) {
  if (winograd_pays<T>(g)) {
    convolve_tiles(g, source, pack_transformed<T>(g, weight), bias, relu, positive, out, threads);
  } else {
    convolve_rows(g, source, pack<T>(g, weight), bias, relu, positive, out, threads);
  }
}

// --------------------------------------------------------------------------------------------- gradient of the weights

constexpr int64_t chunks = 64;  // about as many partial sums

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
void correlate(const Geometry& g, const Source<T>& input, const Source<T>& grad, const Chunk& chunk, int64_t o,
               int64_t c, int64_t kz, int64_t ky, int64_t stride, T* sums) {
  const int64_t plane = g.out_rows() * grad.pitch, last = vector_start<T>(vectors_in<T>(g.out_width) - 1, g.out_width);
  const int64_t center = grad.padded ? grad.column[1] : 0;
  constexpr int L = lanes<T>;
  const LaneRange<T> all(0, L), left(input.padded ? 0 : 1, L), right(0, input.padded ? L : L - 1);
  const LaneRange<T> fresh(grad.padded ? 0 : (L - g.out_width % L) % L, L);  // what the vector before has not seen
  vec<T> sum[CO][3] = {};
  for (int64_t p = chunk.first; p < chunk.last; ++p) {
    const int64_t n = p / g.out_depth, z = p % g.out_depth;
    for (int64_t y = chunk.begin; y < chunk.end; ++y) {
      const int64_t iz = g.plane(z, kz), iy = g.row(y, ky);
      if (iz < 0 || iy < 0) continue;
      const T* row = input.data + ((n * g.in_channels + c) * g.in_rows() + iz * g.in_height + iy) * input.pitch;
      const T* to = grad.data + (n * g.out_channels + o) * plane + (z * g.out_height + y) * grad.pitch + center;
      const auto step = [&](int64_t x, LaneRange<T> left, LaneRange<T> right,
                            LaneRange<T> fresh) __attribute__((always_inline)) {
        const vec<T> pixels[3] = {load(row + input.column[0] + x, left), load(row + input.column[1] + x),
                                  load(row + input.column[2] + x, right)};
#pragma GCC unroll 8
        for (int i = 0; i < CO; ++i) {
          const vec<T> v = load(to + i * plane + x, fresh);
#pragma GCC unroll 3
          for (int kx = 0; kx < 3; ++kx) sum[i][kx] += v * pixels[kx];
          read_after(to, sum[i][2]);
        }
      };
      if (last > 0) step(0, left, all, all);
      for (int64_t x = L; x < last; x += L) step(x, all, all, all);
      step(last, last == 0 ? left : all, right, fresh);
    }
  }
  for (int i = 0; i < CO; ++i) {
    for (int kx = 0; kx < 3; ++kx) sums[i * stride + kx] = sum_lanes<T>(sum[i][kx]);
  }
}

}  // namespace

template <class T>
void conv(const Conv<T>& a, int available) {
  const Geometry g(a.shape);
  const int threads = g.threads(available);
  const int64_t size = g.in_channels * g.taps() * 3, depth = g.taps() * 3;
  const auto weight = [&](int64_t o, int64_t c, int64_t t) { return a.weight[o * size + c * depth + t]; };
  const bool direct = a.scale == nullptr && !a.relu_in && g.out_width >= lanes<T>;
  const Source<T> source = direct ? Source<T>(a.input, g.in_width)
                                  : Source<T>(a.input, g.batch * g.in_channels * g.in_rows(), g.in_width, g.out_width,
                                              g.stride, 1, threads, activation<T>(a));
  convolve(g, source, weight, a.bias, a.relu_out, static_cast<const T*>(nullptr), a.out, threads);
}

template <class T>
void conv_backward_input(const ConvBackwardInput<T>& a, int available) {
  const Geometry g = Geometry(a.shape).backward();
  const int threads = g.threads(available);
  const int64_t size = g.out_channels * g.taps() * 3, depth = g.taps() * 3;
  const auto weight = [&](int64_t c, int64_t o, int64_t t) { return a.weight[o * size + c * depth + depth - 1 - t]; };
  const bool direct = g.dilation == 1 && g.out_width >= lanes<T>;
  const Source<T> source = direct ? Source<T>(a.grad, g.in_width)
                                  : Source<T>(a.grad, g.batch * g.in_channels * g.in_rows(), g.in_width, g.out_width, 1,
                                              g.dilation, threads, identity<T>);
  convolve(g, source, weight, static_cast<const T*>(nullptr), false, a.before, a.grad_input, threads);
}

template <class T>
void conv_backward_weight(const ConvBackwardWeight<T>& a, int available) {
  const Geometry g(a.shape);
  const int threads = g.threads(available);
  const int64_t W = g.out_width, depth = g.taps() * 3, size = g.in_channels * depth;
  const bool direct = a.scale == nullptr && !a.relu_in && g.stride == 1 && W >= lanes<T>;
  const Source<T> input = direct ? Source<T>(a.input, g.in_width)
                                 : Source<T>(a.input, g.batch * g.in_channels * g.in_rows(), g.in_width, W, g.stride, 1,
                                             threads, activation<T>(a));
  const Source<T> grad =
      W >= lanes<T> ? Source<T>(a.grad, W)
                    : Source<T>(a.grad, g.batch * g.out_channels * g.out_rows(), W, W, 1, 1, threads, identity<T>);
  const int64_t planes = g.batch * g.out_depth;
  const int64_t groups = std::min(planes, chunks);
  const int64_t parts = planes == 0 ? 0 : std::max<int64_t>(1, std::min(g.out_height, chunks / planes));
  const int64_t count = groups * parts, total = g.out_channels * (size + 1);
  Vector<T> partial(count * total);  // per chunk [O][C][tap][kx], then the bias' [O]
  parallel_for(count, threads, [&](int64_t i) {
    const int64_t group = i / parts, part = i % parts;
    const Chunk chunk{planes * group / groups, planes * (group + 1) / groups, g.out_height * part / parts,
                      g.out_height * (part + 1) / parts};
    T* sums = partial.data() + i * total;
    for (int64_t o = 0, step; o < g.out_channels; o += step) {
      step = block_at(o, g.out_channels, max_channels);
      const auto kernel = step == 8   ? correlate<T, 8>
                          : step == 4 ? correlate<T, 4>
                          : step == 2 ? correlate<T, 2>
                                      : correlate<T, 1>;
      for (int64_t c = 0; c < g.in_channels; ++c) {
        for (int64_t t = 0; t < g.taps(); ++t) {
          kernel(g, input, grad, chunk, o, c, t / 3, t % 3, size, sums + o * size + c * depth + t * 3);
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
