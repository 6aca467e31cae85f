#include "../common/parallel.h"
#include "../common/sampling.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "../common/transpose.h"
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
      : before_(before), pitch_(round_up(before + width + after, lanes<A>)), data_(channels, pitch_) {
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
  template <int n>
  ANYNET_INLINE void descending(const A* row, int64_t move, vec<A>* out) const {
    for (int i = 0; i < n; ++i) out[i] = load(row + x_ + move - i);
  }

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
    vec<A> r[K + Between];
    gather.template descending<K + Between>(right[c], Between - first, r);
    for (int k = 0; k < K; ++k) {
      sum[k] += absolute<A>(l - (Between ? (1 - fraction) * r[k + Between] + fraction * r[k] : r[k]));
    }
  }
  for (int k = 0; k < K; ++k) sums[k] = sum[k];
}

/// The same for any number of offsets: as many at a time as fit the registers.
template <bool Between, class A, class Gather>
ANYNET_INLINE void sum_all_differences(const Rows<A>& left, const Rows<A>& right, int64_t C, int64_t x, int64_t first,
                                       int64_t K, const Gather& gather, vec<A> fraction, vec<A>* sums) {
  constexpr int most = Between ? Positions<A>::neighbors - 1 : vector_bytes == 64 ? 16 : 8;
  int64_t k = 0;
  const auto run = [&](auto count) {
    sum_differences<count(), Between>(left, right, C, x, first + k, gather, fraction, sums + k);
    k += count();
  };
  while (K - k >= most) run(Constant<most>{});
  if constexpr (!Between) {
    if (K - k >= 8) run(Constant<8>{});
  }
  while (K - k >= 5) run(Constant<5>{});
  if (K - k >= 3) run(Constant<3>{});
  while (K - k >= 1) run(Constant<1>{});
}

}  // namespace

template <class T>
void cost_volume(const CostVolume<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  const bool around = a.disparity.data != nullptr;
  if (W == 0) return;
  // Beyond these every offset leads outside.
  const int64_t first = clamp(a.first, -W - K, W);
  const int64_t before = around ? K + 2 : clamp(first + K - 1, 0, W + K);
  const int64_t after = (around ? K : clamp(-first, 0, W + K)) + 3 * lanes<A>;
  parallel_ranges(N * H, useful_threads(threads, N, C, H, W, K, 3), [&](int64_t begin, int64_t end) {
    Rows<A> left(C, 0, W, lanes<A>), right(C, before, W, after);
    Positions<A> at(W);
    Scratch<vec<A>> sums(K);
    const T* seen = nullptr;
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task % N, y = task / N;
      left.read(a.left, n, y);
      right.read(a.right, n, y);
      if (around) {
        const T* map = a.disparity.data + n * a.disparity.stride[0] + y * a.disparity.stride[2];
        if (map != seen) at.read(map, a.disparity.stride[3], a.first, -2, static_cast<int32_t>(W + K - 1));
        seen = map;  // samples may share theirs
      }
      for (int64_t x = 0; x < W; x += lanes<A>) {
        if (around) {
          gather_at(at, x, [&](const auto& gather) {
            sum_all_differences<true, A>(left, right, C, x, 0, K, gather, load(at.fraction + x), sums);
          });
        } else {
          sum_all_differences<false, A>(left, right, C, x, first, K, Shifted<A>(x), vec<A>{}, sums);
        }
        if (a.epilogue.scale != nullptr) {
          const vec<A> scale = splat<A>(to_accumulator(a.epilogue.scale[n % a.epilogue.channels]));
          const vec<A> shift = splat<A>(to_accumulator(a.epilogue.shift[n % a.epilogue.channels]));
          for (int64_t k = 0; k < K; ++k) sums[k] = max<A>(vec<A>{}, scale * sums[k] + shift);
        }
        const int64_t count = W - x < lanes<A> ? W - x : lanes<A>;
        for (int64_t k = 0; k < K; ++k) {
          write_vector<T>(sums[k], count, a.out + ((n * K + k) * H + y) * W + x);
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

/// The gradients of one row at whole offsets: for both sides, the pixels that meet lie at the same distance everywhere.
template <class A>
void backward_at_offsets(const Rows<A>& grad, const Rows<A>& left, const Rows<A>& right, int64_t C, int64_t W,
                         int64_t first, int64_t K, Rows<A>& grad_left, Rows<A>& grad_right) {
  for (int64_t c = 0; c < C; ++c) {
    for (int64_t x = 0; x < W; x += lanes<A>) {
      const vec<A> l = load(left[c] + x), r = load(right[c] + x);
      vec<A> to_left{}, to_right{};
      for (int64_t k = first; k < first + K; ++k) {
        const A* g = grad[k - first] + x;
        to_left += signed_by<A>(load(g), l, load(right[c] + x - k));
        to_right += signed_by<A>(load(g + k), r, load(left[c] + x + k));
      }
      store(grad_left[c] + x, to_left);
      store(grad_right[c] + x, to_right);
    }
  }
}

/// Rows with the channels of a pixel side by side, in whole vectors: what one pixel scatters goes to whole vectors too.
template <class A>
class Pixels {
 public:
  Pixels(int64_t channels, int64_t before, int64_t width, int64_t after)
      : pitch_(round_up(channels, lanes<A>)),
        before_(before),
        count_(before + round_up(width, lanes<A>) + after),
        data_(count_, pitch_) {
    clear();
  }

  A* operator[](int64_t x) const { return data_ + (before_ + x) * pitch_; }
  void clear() { fill_zero<A>(data_, count_ * pitch_); }

  void read(const Rows<A>& rows, int64_t C, int64_t W) {
    for_each_tile(C, W, [&](int64_t c, int64_t x, vec<A>* tile) {
      for (int64_t i = 0; i < lanes<A>; ++i) tile[i] = c + i < C ? load(rows[c + i] + x) : vec<A>{};
      transpose<A>(tile);
      for (int64_t i = 0; i < lanes<A>; ++i) store((*this)[x + i] + c, tile[i]);
    });
  }

  void write(Rows<A>& rows, int64_t C, int64_t W) const {
    for_each_tile(C, W, [&](int64_t c, int64_t x, vec<A>* tile) {
      for (int64_t i = 0; i < lanes<A>; ++i) tile[i] = load((*this)[x + i] + c);
      transpose<A>(tile);
      for (int64_t i = 0; i < lanes<A> && c + i < C; ++i) store(rows[c + i] + x, tile[i]);
    });
  }

 private:
  template <class Body>
  static void for_each_tile(int64_t C, int64_t W, const Body& body) {
    vec<A> tile[lanes<A>];
    for (int64_t c = 0; c < C; c += lanes<A>) {
      for (int64_t x = 0; x < W; x += lanes<A>) body(c, x, tile);
    }
  }

  const int64_t pitch_, before_, count_;
  Scratch<A> data_;
};

/// The gradients of one row around a disparity map.
template <class A>
void backward_around_map(const Rows<A>& grad, const Pixels<A>& left, const Pixels<A>& right, const Positions<A>& at,
                         int64_t C, int64_t W, int64_t K, Pixels<A>& grad_left, Pixels<A>& grad_right,
                         A* grad_disparity) {
  vec<A> to_disparity[lanes<A>] = {};  // of the last pixels, one vector of channels each
  for (int64_t x = 0; x < W; ++x) {
    const A f = at.fraction[x];
    const int64_t i = at.index[x];
    vec<A> slopes{};
    for (int64_t c = 0; c < C; c += lanes<A>) {
      const vec<A> l = load(left[x] + c);
      vec<A> next = load(right[i + 1] + c), to_left{}, from_last{};
      for (int64_t k = 0; k < K; ++k) {
        const vec<A> here = load(right[i - k] + c);
        const vec<A> gs = signed_by<A>(splat<A>(grad[k][x]), l, (1 - f) * here + f * next);
        to_left += gs;
        slopes += gs * (next - here);
        A* const to_next = grad_right[i - k + 1] + c;
        store(to_next, load(to_next) - (from_last + gs * f));
        from_last = gs * (1 - f);
        next = here;
      }
      A* const to_here = grad_right[i - K + 1] + c;
      store(to_here, load(to_here) - from_last);
      store(grad_left[x] + c, to_left);
    }
    to_disparity[x % lanes<A>] = slopes;
    if (x % lanes<A> == lanes<A> - 1 || x == W - 1) {
      transpose<A>(to_disparity);
      vec<A> sum{};
      for (int64_t j = 0; j < lanes<A>; ++j) sum += to_disparity[j];
      store(grad_disparity + x / lanes<A> * lanes<A>, sum);
    }
  }
}

}  // namespace

template <class T>
void cost_volume_backward(const CostVolumeBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.left.size[0], C = a.left.size[1], H = a.left.size[2], W = a.left.size[3], K = a.count;
  const bool around = a.disparity.data != nullptr;
  if (W == 0) return;
  const int64_t first = clamp(a.first, -W - K, W);
  // Left pixel x and right pixel x - first - k meet: each side is read at the other's positions.
  const int64_t behind = (around ? 0 : clamp(first + K - 1, 0, W + K)) + lanes<A>;
  const int64_t ahead = (around ? 0 : clamp(-first, 0, W + K)) + lanes<A>;
  parallel_ranges(N * H, useful_threads(threads, N, C, H, W, K, 8), [&](int64_t begin, int64_t end) {
    Rows<A> left(C, ahead, W, behind + lanes<A>), right(C, behind, W, ahead + lanes<A>);
    Rows<A> grad(K, ahead, W, behind + lanes<A>), grad_left(C, 0, W, lanes<A>), grad_right(C, 0, W, lanes<A>);
    const int64_t channels = around ? C : 0;
    Pixels<A> left_pixels(channels, 0, W, 0), right_pixels(channels, K + 1, W, K + 1);
    Pixels<A> grad_left_pixels(channels, 0, W, 0), grad_right_pixels(channels, K + 1, W, K + 1);
    Positions<A> at(W);
    Scratch<A> grad_disparity(round_up(W, lanes<A>));
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / H, y = task % H;
      left.read(a.left, n, y);
      right.read(a.right, n, y);
      grad.read(a.grad, n, y);
      if (around) {
        at.read(a.disparity.data + n * a.disparity.stride[0] + y * a.disparity.stride[2], a.disparity.stride[3],
                a.first, -2, static_cast<int32_t>(W + K - 1));
        left_pixels.read(left, C, W);
        right_pixels.read(right, C, W);
        grad_right_pixels.clear();
        backward_around_map(grad, left_pixels, right_pixels, at, C, W, K, grad_left_pixels, grad_right_pixels,
                            static_cast<A*>(grad_disparity));
        grad_left_pixels.write(grad_left, C, W);
        grad_right_pixels.write(grad_right, C, W);
        write_row<T>(grad_disparity, W, a.grad_disparity + (n * H + y) * W);
      } else {
        backward_at_offsets(grad, left, right, C, W, first, K, grad_left, grad_right);
      }
      for (int64_t c = 0; c < C; ++c) {
        write_row<T>(grad_left[c], W, a.grad_left + ((n * C + c) * H + y) * W);
        write_row<T>(grad_right[c], W, a.grad_right + ((n * C + c) * H + y) * W);
      }
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(cost_volume, CostVolume)
ANYNET_INSTANTIATE_KERNEL(cost_volume_backward, CostVolumeBackward)

}  // namespace anynet::ANYNET_ISA
