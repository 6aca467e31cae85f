#include "../common/exp.h"
#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "soft_argmin.h"

namespace anynet::ANYNET_ISA {

namespace {

/// The softmax of neighbouring pixels of a row, one pixel per vector lane.
template <class T>
class Softmax {
 public:
  using A = accumulator_t<T>;
  const int64_t
      width;  // pixels at a time: many, to read long pieces of each plane, as far as the nearer caches hold them

  Softmax(int64_t D, int64_t W)
      : width(strip(D, W)), sums(width), means(width), D_(D), costs_(D * width), lowest_(width), line_(width) {
    fill_zero<A>(costs_, D * width);
  }

  /// Reads the costs of `count` pixels from `p` on, and leaves e^(lowest cost - cost) in weights(k).
  void read(const T* p, int64_t stride_k, int64_t stride_x, int64_t count) {
    A* const lowest = lowest_;
    fill_zero(lowest, width);
    for (int64_t k = 0; k < D_; ++k) {
      const A* line = read_row(p + k * stride_k, stride_x, count, static_cast<A*>(line_));
      A* const costs = costs_ + k * width;
      for (int64_t x = 0; x < count; ++x) {
        costs[x] = line[x];
        lowest[x] = k == 0 || line[x] < lowest[x] ? line[x] : lowest[x];
      }
    }
    for (int64_t x = 0; x < count; x += lanes<A>) {
      const vec<A> low = load(lowest + x);
      vec<A> sum{}, weighted{}, index{};
      for (int64_t k = 0; k < D_; ++k) {
        A* const cost = costs_ + k * width + x;
        const vec<A> e = exp_nonpositive<A>(low - load(cost));
        store(cost, e);
        sum += e;
        weighted += e * index;
        index += A(1);
      }
      store(sums + x, sum);
      store(means + x, weighted / sum);
    }
  }

  const A* weights(int64_t k) { return costs_ + k * width; }

  const Scratch<A> sums;   // of the weights
  const Scratch<A> means;  // of the index k, by the weights

 private:
  static int64_t strip(int64_t D, int64_t W) {
    constexpr int64_t bytes = 512 * 1024, least = 4 * lanes<A>;
    const int64_t fits = bytes / (D * static_cast<int64_t>(sizeof(A))) / lanes<A> * lanes<A>,
                  row = round_up(W, lanes<A>);
    return fits < least ? least : fits < row ? fits : row;
  }

  const int64_t D_;
  Scratch<A> costs_, lowest_, line_;
};

}  // namespace

template <class T>
void soft_argmin(const SoftArgmin<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.cost.size[0], D = a.cost.size[1], H = a.cost.size[2], W = a.cost.size[3];
  const int64_t* stride = a.cost.stride;
  parallel_ranges(N * H, useful_threads(N * D * H * W * 10, threads), [&](int64_t begin, int64_t end) {
    Softmax<T> softmax(D, W);
    for (int64_t row = begin; row < end; ++row) {
      const T* cost = a.cost.data + row / H * stride[0] + row % H * stride[2];
      for (int64_t x = 0; x < W; x += softmax.width) {
        const int64_t count = W - x < softmax.width ? W - x : softmax.width;
        softmax.read(cost + x * stride[3], stride[1], stride[3], count);
        for (int64_t i = 0; i < count; ++i) softmax.means[i] += static_cast<A>(a.first);
        write_row<T>(softmax.means, count, a.out + row * W + x);
      }
    }
  });
}

template <class T>
void soft_argmin_backward(const SoftArgminBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.cost.size[0], D = a.cost.size[1], H = a.cost.size[2], W = a.cost.size[3];
  const int64_t* stride = a.cost.stride;
  parallel_ranges(N * H, useful_threads(N * D * H * W * 14, threads), [&](int64_t begin, int64_t end) {
    Softmax<T> softmax(D, W);
    Scratch<A> grad(softmax.width), line(softmax.width);
    for (int64_t row = begin; row < end; ++row) {
      const int64_t n = row / H, y = row % H;
      const T* cost = a.cost.data + n * stride[0] + y * stride[2];
      const T* arriving = a.grad.data + n * a.grad.stride[0] + y * a.grad.stride[2];
      for (int64_t x = 0; x < W; x += softmax.width) {
        const int64_t count = W - x < softmax.width ? W - x : softmax.width;
        softmax.read(cost + x * stride[3], stride[1], stride[3], count);
        copy_row(arriving + x * a.grad.stride[3], a.grad.stride[3], count, static_cast<A*>(grad));
        for (int64_t i = 0; i < count; ++i) grad[i] /= softmax.sums[i];
        for (int64_t k = 0; k < D; ++k) {
          const A* weights = softmax.weights(k);
          for (int64_t i = 0; i < count; ++i) {
            line[i] = grad[i] * weights[i] * (softmax.means[i] - static_cast<A>(k));
          }
          write_row<T>(line, count, a.grad_cost + ((n * D + k) * H + y) * W + x);
        }
      }
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(soft_argmin, SoftArgmin)
ANYNET_INSTANTIATE_KERNEL(soft_argmin_backward, SoftArgminBackward)

}  // namespace anynet::ANYNET_ISA
