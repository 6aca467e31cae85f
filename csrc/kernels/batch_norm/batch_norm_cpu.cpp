#include <algorithm>
#include <cmath>

#include "../common/parallel.h"
#include "../common/simd.h"
#include "../common/vector.h"
#include "batch_norm.h"

namespace anynet::ANYNET_ISA {
namespace {

constexpr int64_t piece_bytes = 16 << 10;  // so that a second look at a piece finds it in the nearest cache

/// The pieces of the planes (n, c) that a channel is summed in.
template <class T>
struct Pieces {
  int64_t channels, pixels, size, per_plane, per_channel;

  template <class Args>
  explicit Pieces(const Args& a)
      : channels(a.channels),
        pixels(a.pixels),
        size(piece_bytes / int64_t{sizeof(T)}),
        per_plane((pixels + size - 1) / size),
        per_channel(a.batch * per_plane) {}

  int64_t count() const { return channels * per_channel; }
  int64_t channel(int64_t i) const { return i / per_channel; }
  /// Where piece i begins in the tensor, and how many elements it has.
  int64_t begin(int64_t i) const {
    const int64_t n = i % per_channel / per_plane, part = i % per_plane;
    return (n * channels + channel(i)) * pixels + part * size;
  }
  int64_t length(int64_t i) const { return std::min(size, pixels - i % per_plane * size); }
  int threads(int available) const { return useful_threads(available, count(), std::min(size, pixels), 4); }
};

/// The first `count` elements from p on, or of v, and zeros. In full vectors the compiler knows `count`.
template <class T>
ANYNET_INLINE vec<T> first(int64_t count, const T* p) {
  if (count == lanes<T>) return load(p);
  vec<T> v{};
  std::memcpy(&v, p, count * sizeof(T));
  return v;
}
template <class T>
ANYNET_INLINE vec<T> first(int64_t count, vec<T> v) {
  return count == lanes<T> ? v : first(count, reinterpret_cast<const T*>(&v));
}

/// Calls body(x, count) for each vector of [0, length); the last one may have fewer elements than lanes.
template <class T, class Body>
ANYNET_INLINE void for_each_vector(int64_t length, const Body& body) {
  int64_t x = 0;
  for (; x + lanes<T> <= length; x += lanes<T>) body(x, int64_t{lanes<T>});
  if (x < length) body(x, length - x);
}

/// Sums over [0, length) of what terms(x, count, sums) adds to K vectors of sums, for the `count` elements from x on.
template <class T, int K, class Terms>
ANYNET_INLINE void sum_terms(int64_t length, const Terms& terms, double (&sums)[K]) {
  constexpr int chains = 4;  // additions that do not wait for one another
  vec<T> sum[chains][K] = {};
  int64_t x = 0;
  for (; x + chains * lanes<T> <= length; x += chains * lanes<T>) {
#pragma GCC unroll 4
    for (int i = 0; i < chains; ++i) terms(x + i * lanes<T>, int64_t{lanes<T>}, sum[i]);
  }
  for (; x < length; x += lanes<T>) terms(x, std::min<int64_t>(lanes<T>, length - x), sum[0]);
  for (int k = 0; k < K; ++k) {
    const vec<T> all = sum[0][k] + sum[1][k] + (sum[2][k] + sum[3][k]);
    sums[k] = 0;
    for (int i = 0; i < lanes<T>; ++i) sums[k] += all[i];
  }
}

/// The batch norm of a channel.
template <class T>
struct Norm {
  T mean, scale, bias;

  template <class Args>
  Norm(const Args& a, int64_t c)
      : mean(a.mean[c]), scale(static_cast<T>(a.weight[c] / std::sqrt(a.variance[c] + a.eps))), bias(a.bias[c]) {}

  ANYNET_INLINE vec<T> operator()(vec<T> x) const { return scale * (x - mean) + bias; }
};

/// The gradients that come through the ReLU.
template <class T>
ANYNET_INLINE vec<T> passed(const Norm<T>& norm, vec<T> x, vec<T> grad) {
  return norm(x) <= vec<T>{} ? vec<T>{} : grad;
}

}  // namespace

template <class T>
void batch_norm_relu(const BatchNormRelu<T>& a, int available) {
  const Pieces<T> pieces(a);
  const int threads = pieces.threads(available);
  Vector<double> means(pieces.count()), squares(pieces.count());  // of each piece: mean, sum of squares around it
  parallel_for(pieces.count(), threads, [&](int64_t i) {
    const T* x = a.input + pieces.begin(i);
    const int64_t length = pieces.length(i);
    double sum[1], square[1];
    sum_terms<T>(length, [&](int64_t at, int64_t count, vec<T>* to) { to[0] += first(count, x + at); }, sum);
    means[i] = sum[0] / length;
    const T middle = static_cast<T>(means[i]);
    sum_terms<T>(
        length,
        [&](int64_t at, int64_t count, vec<T>* to) {
          const vec<T> away = first<T>(count, first(count, x + at) - middle);
          to[0] += away * away;
        },
        square);
    squares[i] = square[0] - length * (means[i] - middle) * (means[i] - middle);
  });
  for (int64_t c = 0; c < a.channels; ++c) {
    double count = 0, mean = 0, square = 0;  // Chan, Golub and LeVeque 1979
    for (int64_t i = c * pieces.per_channel; i < (c + 1) * pieces.per_channel; ++i) {
      const double more = static_cast<double>(pieces.length(i)), away = means[i] - mean;
      square += squares[i] + away * away * count * more / (count + more);
      count += more;
      mean += away * more / count;
    }
    a.mean[c] = static_cast<T>(mean), a.variance[c] = static_cast<T>(square / count);
  }
  parallel_for(pieces.count(), threads, [&](int64_t i) {
    const Norm<T> norm(a, pieces.channel(i));
    const int64_t begin = pieces.begin(i);
    for_each_vector<T>(pieces.length(i), [&](int64_t at, int64_t count) {
      const vec<T> value = max<T>(vec<T>{}, norm(first(count, a.input + begin + at)));  // keeps NaN
      std::memcpy(a.out + begin + at, &value, count * sizeof(T));
    });
  });
}

template <class T>
void batch_norm_relu_backward(const BatchNormReluBackward<T>& a, int available) {
  const Pieces<T> pieces(a);
  const int threads = pieces.threads(available);
  Vector<double> sums(pieces.count()), products(pieces.count());
  parallel_for(pieces.count(), threads, [&](int64_t i) {
    const int64_t c = pieces.channel(i), begin = pieces.begin(i);
    const Norm<T> norm(a, c);
    const T *x = a.input + begin, *grad = a.grad + begin;
    double both[2];
    sum_terms<T>(
        pieces.length(i),
        [&](int64_t at, int64_t count, vec<T>* to) {
          const vec<T> input = first(count, x + at), g = passed(norm, input, first(count, grad + at));
          to[0] += g;
          to[1] += g * (input - norm.mean);
        },
        both);
    sums[i] = both[0], products[i] = both[1];
  });
  Vector<T> even(a.channels), slope(a.channels);  // what is taken from every element's gradient, and per input - mean
  for (int64_t c = 0; c < a.channels; ++c) {
    double sum = 0, product = 0;
    for (int64_t i = c * pieces.per_channel; i < (c + 1) * pieces.per_channel; ++i) {
      sum += sums[i], product += products[i];
    }
    const double count = static_cast<double>(a.batch * a.pixels), power = 1 / (a.variance[c] + a.eps);
    a.grad_bias[c] = static_cast<T>(sum);
    a.grad_weight[c] = static_cast<T>(product * std::sqrt(power));
    even[c] = static_cast<T>(sum / count), slope[c] = static_cast<T>(product * power / count);
  }
  parallel_for(pieces.count(), threads, [&](int64_t i) {
    const int64_t c = pieces.channel(i), begin = pieces.begin(i);
    const Norm<T> norm(a, c);
    for_each_vector<T>(pieces.length(i), [&](int64_t at, int64_t count) {
      const vec<T> x = first(count, a.input + begin + at), g = passed(norm, x, first(count, a.grad + begin + at));
      const vec<T> value = norm.scale * (g - even[c] - slope[c] * (x - norm.mean));
      std::memcpy(a.grad_input + begin + at, &value, count * sizeof(T));
    });
  });
}

#define ANYNET_INSTANTIATE_BATCH_NORM(T)                          \
  template void batch_norm_relu<T>(const BatchNormRelu<T>&, int); \
  template void batch_norm_relu_backward<T>(const BatchNormReluBackward<T>&, int);

ANYNET_INSTANTIATE_BATCH_NORM(float)
ANYNET_INSTANTIATE_BATCH_NORM(double)

}  // namespace anynet::ANYNET_ISA
