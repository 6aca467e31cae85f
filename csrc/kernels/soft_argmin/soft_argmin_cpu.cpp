#include <algorithm>
#include <limits>

#include "../common/exp.h"
#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "soft_argmin.h"

namespace anynet::ANYNET_ISA {

namespace {

/// Whether rows follow one another so that they are one long row.
template <class T>
bool is_flat(const View4<T>& v) {
  return v.stride[2] == v.size[3] * v.stride[3];
}

template <class T>
View4<T> flattened(View4<T> v) {
  v.size[3] *= v.size[2];
  v.size[2] = 1;
  return v;
}

/// Pieces of rows, each small enough for the nearer caches to hold all its planes.
class Strips {
 public:
  template <class T>
  Strips(const View4<T>& cost, int threads) : H_(cost.size[2]), W_(cost.size[3]), width(W_) {
    using A = accumulator_t<T>;
    const int64_t plane = 512 * 1024 / (cost.size[1] * static_cast<int64_t>(sizeof(A)));
    const int64_t share = (cost.size[0] * H_ * W_ + threads - 1) / std::max(threads, 1);
    const int64_t most = std::max(std::min(plane, share), int64_t{4} * lanes<A>);
    width = std::max(std::min(most / lanes<A> * lanes<A>, round_up(W_, lanes<A>)), int64_t{1});
    per_row_ = (W_ + width - 1) / width;
    count = cost.size[0] * H_ * per_row_;
  }

  int64_t n(int64_t i) const { return i / per_row_ / H_; }
  int64_t y(int64_t i) const { return i / per_row_ % H_; }
  int64_t x(int64_t i) const { return i % per_row_ * width; }
  int64_t pixels(int64_t i) const { return std::min(W_ - x(i), width); }

  /// Of pixel (n, y, x) of strip i, in plane 0.
  template <class T>
  T* start(const View4<T>& v, int64_t i) const {
    return v.data + n(i) * v.stride[0] + y(i) * v.stride[2] + x(i) * v.stride[3];
  }

 private:
  int64_t H_, W_, per_row_;

 public:
  int64_t width, count;
};

/// The softmax of a strip's pixels, one pixel per vector lane, in one pass over the costs: what has been summed up is
/// scaled down whenever a lower cost turns up (Milakov and Gimelshein 2018, arXiv 1805.02867).
template <class T>
class Softmax {
 public:
  using A = accumulator_t<T>;

  explicit Softmax(int64_t width) : lowest(width), sums(width), means(width), width_(width), lines_(planes, width) {}

  /// Reads all planes of `count` pixels.
  void read(const View4<const T>& cost, const T* start, int64_t count) {
    for (int64_t x = 0; x < width_; ++x) lowest[x] = std::numeric_limits<A>::max();
    fill_zero<A>(sums, width_);
    fill_zero<A>(means, width_);
    int64_t k = 0;
    const auto run = [&](auto n) {
      add<n()>(cost, start, k, count);
      k += n();
    };
    while (cost.size[1] - k >= planes) run(Constant<planes>{});
    while (cost.size[1] - k >= 1) run(Constant<1>{});
    for (int64_t x = 0; x < width_; x += lanes<A>) store(means + x, load(means + x) / load(sums + x));
  }

  /// Calls body(x, costs of the pixels from x on in planes k, k + 1, ... k + n - 1).
  template <int n, class Body>
  ANYNET_INLINE void for_each_vector(const View4<const T>& cost, const T* start, int64_t k, int64_t count,
                                     const Body& body) {
    const A* line[n];
    for (int i = 0; i < n; ++i) {
      line[i] = read_row(start + (k + i) * cost.stride[1], cost.stride[3], count, lines_ + i * width_);
    }
    vec<A> costs[n];
    int64_t x = 0;
    for (; x + lanes<A> <= count; x += lanes<A>) {
      for (int i = 0; i < n; ++i) costs[i] = load(line[i] + x);
      body(x, costs);
    }
    if (x == count) return;
    for (int i = 0; i < n; ++i) costs[i] = read_vector(line[i] + x, 1, count - x);
    body(x, costs);
  }

  const Scratch<A> lowest;  // cost
  const Scratch<A> sums;    // of e^(lowest - cost)
  const Scratch<A> means;   // of the index k, weighted so

 private:
  static constexpr int planes = 4;  // at a time

  template <int n>
  void add(const View4<const T>& cost, const T* start, int64_t k, int64_t count) {
    for_each_vector<n>(cost, start, k, count, [&](int64_t x, const vec<A>* costs) {
      const vec<A> before = load(lowest + x);
      vec<A> low = before;
      for (int i = 0; i < n; ++i) low = min<A>(costs[i], low);
      const vec<A> scale = exp_nonpositive<A>(low - before);
      vec<A> sum{}, index{};
      for (int i = 0; i < n; ++i) {
        const vec<A> e = exp_nonpositive<A>(low - costs[i]);
        sum += e;
        index += e * A(i);
      }
      store(lowest + x, low);
      store(sums + x, load(sums + x) * scale + sum);
      store(means + x, load(means + x) * scale + (sum * static_cast<A>(k) + index));
    });
  }

  const int64_t width_;
  Scratch<A> lines_;
};

}  // namespace

template <class T>
void soft_argmin(const SoftArgmin<T>& a, int threads) {
  using A = accumulator_t<T>;
  const View4<const T> cost = is_flat(a.cost) ? flattened(a.cost) : a.cost;
  const int64_t N = cost.size[0], D = cost.size[1], H = cost.size[2], W = cost.size[3];
  threads = useful_threads(threads, N, D, H, W, 10);
  const Strips strips(cost, threads);
  parallel_ranges(strips.count, threads, [&](int64_t begin, int64_t end) {
    Softmax<T> softmax(strips.width);
    for (int64_t i = begin; i < end; ++i) {
      const int64_t count = strips.pixels(i);
      softmax.read(cost, strips.start(cost, i), count);
      for (int64_t j = 0; j < count; ++j) softmax.means[j] += static_cast<A>(a.first);
      write_row<T>(softmax.means, count, a.out + (strips.n(i) * H + strips.y(i)) * W + strips.x(i));
    }
  });
}

template <class T>
void soft_argmin_backward(const SoftArgminBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const bool flat = is_flat(a.cost) && is_flat(a.grad);
  const View4<const T> cost = flat ? flattened(a.cost) : a.cost, grad = flat ? flattened(a.grad) : a.grad;
  const int64_t N = cost.size[0], D = cost.size[1], H = cost.size[2], W = cost.size[3];
  threads = useful_threads(threads, N, D, H, W, 14);
  const Strips strips(cost, threads);
  parallel_ranges(strips.count, threads, [&](int64_t begin, int64_t end) {
    Softmax<T> softmax(strips.width);
    Scratch<A> factor(strips.width);
    for (int64_t i = begin; i < end; ++i) {
      const int64_t count = strips.pixels(i);
      const T* start = strips.start(cost, i);
      softmax.read(cost, start, count);
      copy_row(strips.start(grad, i), grad.stride[3], count, static_cast<A*>(factor));
      for (int64_t j = 0; j < count; ++j) factor[j] /= softmax.sums[j];
      for (int64_t k = 0; k < D; ++k) {
        T* const out = a.grad_cost + ((strips.n(i) * D + k) * H + strips.y(i)) * W + strips.x(i);
        softmax.template for_each_vector<1>(cost, start, k, count, [&](int64_t x, const vec<A>* costs) {
          const vec<A> e = exp_nonpositive<A>(load(softmax.lowest + x) - *costs);
          const vec<A> grad = load(factor + x) * e * (load(softmax.means + x) - static_cast<A>(k));
          write_vector<T>(grad, count - x < lanes<A> ? count - x : lanes<A>, out + x);
        });
      }
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(soft_argmin, SoftArgmin)
ANYNET_INSTANTIATE_KERNEL(soft_argmin_backward, SoftArgminBackward)

}  // namespace anynet::ANYNET_ISA
