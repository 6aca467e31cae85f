#include "../common/parallel.h"
#include "../common/sampling.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "cost_volume.h"

namespace anynet::ANYNET_ISA {

namespace {

constexpr int64_t clamp(int64_t value, int64_t low, int64_t high) {
  return value < low ? low : value > high ? high : value;
}

/// One row of every channel, as accumulators, with zeros before and after each.
template <class A>
class Rows {
 public:
  Rows(int64_t channels, int64_t before, int64_t width, int64_t after)
      : before_(before), pitch_(round_up(before + width + after, lanes<A>)), data_(channels * pitch_) {
    fill_zero<A>(data_, channels * pitch_);
  }

  template <class T>
  void read(const View4<const T>& v, int64_t n, int64_t y) {
    for (int64_t c = 0; c < v.size[1]; ++c) {
      copy_row(v.data + n * v.stride[0] + c * v.stride[1] + y * v.stride[2], v.stride[3], v.size[3], (*this)[c]);
    }
  }
  A* operator[](int64_t c) const { return data_ + c * pitch_ + before_; }

 private:
  const int64_t before_, pitch_;
  Scratch<A> data_;
};

/// The right row at whole offsets: column x + move.
template <class A>
class Shifted {
 public:
  explicit Shifted(int64_t x) : x_(x) {}
  ANYNET_INLINE vec<A> operator()(const A* row, int64_t move) const { return load(row + x_ + move); }

 private:
  const int64_t x_;
};

/// sums[k] = sum_c | left[c][x..] - right[c] sampled at offset k |, for K offsets from `first` on, in registers.
/// With a fraction, samples lie between the columns `-first - k` and the ones to their right.
template <int K, bool Between, class A, class Gather>
ANYNET_INLINE void sum_differences(const Rows<A>& left, const Rows<A>& right, int64_t C, int64_t x, int64_t first,
                                   const Gather& gather, vec<A> fraction, vec<A>* sums) {
  vec<A> sum[K] = {};
  for (int64_t c = 0; c < C; ++c) {
    const vec<A> l = load(left[c] + x);
    vec<A> next = Between ? gather(right[c], 1 - first) : vec<A>{};
    for (int k = 0; k < K; ++k) {
      const vec<A> here = gather(right[c], -first - k);
      sum[k] += absolute<A>(l - (Between ? (1 - fraction) * here + fraction * next : here));
      next = here;
    }
  }
  for (int k = 0; k < K; ++k) sums[k] = sum[k];
}

/// The same for any number of offsets: as many at a time as fit the registers.
template <bool Between, class A, class Gather>
ANYNET_INLINE void sum_all_differences(const Rows<A>& left, const Rows<A>& right, int64_t C, int64_t x, int64_t first,
                                       int64_t K, const Gather& gather, vec<A> fraction, vec<A>* sums) {
  constexpr int most = vector_bytes == 64 ? 16 : 8;
  int64_t k = 0;
  const auto run = [&](auto count) {
    sum_differences<count(), Between>(left, right, C, x, first + k, gather, fraction, sums + k);
    k += count();
  };
  while (K - k >= most) run(Constant<most>{});
  if (K - k >= 8) run(Constant<8>{});
  while (K - k >= 5) run(Constant<5>{});
  if (K - k >= 3) run(Constant<3>{});
  while (K - k >= 1) run(Constant<1>{});
}

}  // namespace

template <class T>
void cost_volume(const CostVolume<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  const bool between = a.disparity.data != nullptr;
  if (W == 0) return;
  // Beyond these every offset leads outside.
  const int64_t first = clamp(a.first, -W - K, W);
  const int64_t before = between ? K + 2 : clamp(first + K - 1, 0, W + K);
  const int64_t after = (between ? K : clamp(-first, 0, W + K)) + 3 * lanes<A>;
  parallel_ranges(N * H, useful_threads(N * C * H * W * K * 3, threads), [&](int64_t begin, int64_t end) {
    Rows<A> left(C, 0, W, lanes<A>), right(C, before, W, after);
    Positions<A> at(W);
    Scratch<vec<A>> sums(K);
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      left.read(a.left, n, y);
      right.read(a.right, n, y);
      if (between) {
        at.read(a.disparity.data + n * a.disparity.stride[0] + y * a.disparity.stride[2], a.disparity.stride[3],
                a.first, -2, static_cast<int32_t>(W + K - 1));
      }
      for (int64_t x = 0; x < W; x += lanes<A>) {
        if (between) {
          gather_at(at, x, [&](const auto& gather) {
            sum_all_differences<true, A>(left, right, C, x, 0, K, gather, load(at.fraction + x), sums);
          });
        } else {
          sum_all_differences<false, A>(left, right, C, x, first, K, Shifted<A>(x), vec<A>{}, sums);
        }
        const int64_t count = W - x < lanes<A> ? W - x : lanes<A>;
        for (int64_t k = 0; k < K; ++k) {
          A sum[lanes<A>];
          store(sum, sums[k]);
          write_row<T>(sum, count, a.out + ((n * K + k) * H + y) * W + x);
        }
      }
    }
  });
}

namespace {

/// g where left > right, -g where left < right, 0 elsewhere (NaN too).
template <class A>
ANYNET_INLINE vec<A> signed_by(vec<A> g, vec<A> left, vec<A> right) {
  return left > right ? g : left < right ? -g : vec<A>{};
}

}  // namespace

template <class T>
void cost_volume_backward(const CostVolumeBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  const bool between = a.disparity.data != nullptr;
  if (W == 0) return;
  const int64_t first = clamp(a.first, -W - K, W), last = first + K - 1;
  // Left pixel x and right pixel j = x - first - k meet: each side is read at the other's positions.
  const int64_t before = (between ? K + 2 : clamp(last, 0, W + K)) + lanes<A>;
  const int64_t after = (between ? K : clamp(-first, 0, W + K)) + 3 * lanes<A>;
  parallel_ranges(N * H, useful_threads(N * C * H * W * K * 8, threads), [&](int64_t begin, int64_t end) {
    const int64_t width = round_up(W, lanes<A>);
    Rows<A> left(C, after, W, before), right(C, before, W, after), grad(K, after, W, before);
    Rows<A> scattered(1, before, W, after);
    Positions<A> at(W);
    Scratch<A> grad_left(width), grad_disparity(width);
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      left.read(a.left, n, y);
      right.read(a.right, n, y);
      grad.read(a.grad, n, y);
      if (between) {
        at.read(a.disparity.data + n * a.disparity.stride[0] + y * a.disparity.stride[2], a.disparity.stride[3],
                a.first, -2, static_cast<int32_t>(W + K - 1));
        fill_zero<A>(grad_disparity, W);
      }
      for (int64_t c = 0; c < C; ++c) {
        A* const grad_right = scattered[0];
        if (!between) {
          for (int64_t x = 0; x < W; x += lanes<A>) {
            const vec<A> l = load(left[c] + x), r = load(right[c] + x);
            vec<A> to_left{}, to_right{};
            for (int64_t k = 0; k < K; ++k) {
              to_left += signed_by<A>(load(grad[k] + x), l, load(right[c] + x - first - k));
              to_right += signed_by<A>(load(grad[k] + x + first + k), r, load(left[c] + x + first + k));
            }
            store(grad_left + x, to_left);
            store(grad_right + x, to_right);
          }
        } else {
          fill_zero<A>(grad_right - before, before + W + after);
          for (int64_t x = 0; x < W; ++x) {
            const A f = at.fraction[x], l = left[c][x];
            const A* r = right[c] + at.index[x];
            A* const to_right = grad_right + at.index[x];
            A to_left = 0, to_disparity = 0;
            for (int64_t k = 0; k < K; ++k) {
              const A sample = (1 - f) * r[-k] + f * r[1 - k], g = grad[k][x];
              const A gs = l > sample ? g : l < sample ? -g : 0;
              to_left += gs;
              to_disparity += gs * (r[1 - k] - r[-k]);
              to_right[-k] -= gs * (1 - f);
              to_right[1 - k] -= gs * f;
            }
            grad_left[x] = to_left;
            grad_disparity[x] += to_disparity;
          }
        }
        write_row<T>(grad_left, W, a.grad_left + ((n * C + c) * H + y) * W);
        write_row<T>(grad_right, W, a.grad_right + ((n * C + c) * H + y) * W);
      }
      if (between) write_row<T>(grad_disparity, W, a.grad_disparity + (n * H + y) * W);
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(cost_volume, CostVolume)
ANYNET_INSTANTIATE_KERNEL(cost_volume_backward, CostVolumeBackward)

}  // namespace anynet::ANYNET_ISA
