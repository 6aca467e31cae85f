#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "resize.h"

namespace anynet::ANYNET_ISA {

/// For each output position along one axis: the two input pixels and the weight of the second.
template <class A>
struct Taps {
  Scratch<int32_t> low, high;
  Scratch<A> weight;

  Taps(int64_t from, int64_t to, bool align_corners) : low(to), high(to), weight(to) {
    for (int64_t q = 0; q < to; ++q) {
      double p;
      if (align_corners) {
        p = to > 1 ? static_cast<double>(q) * static_cast<double>(from - 1) / static_cast<double>(to - 1) : 0;
      } else {
        p = (static_cast<double>(q) + 0.5) * static_cast<double>(from) / static_cast<double>(to) - 0.5;
        p = p < 0 ? 0 : p;
      }
      int64_t i = static_cast<int64_t>(p);
      i = i > from - 1 ? from - 1 : i;
      low[q] = static_cast<int32_t>(i);
      high[q] = static_cast<int32_t>(i + 1 < from && from != to ? i + 1 : i);  // of one size, each is itself, NaN too
      weight[q] = static_cast<A>(p - static_cast<double>(i));
    }
  }
};

template <class T>
void resize(const Resize<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t C = a.input.size[1], h = a.input.size[2], w = a.input.size[3], H = a.height, W = a.width;
  const int64_t rows = a.input.size[0] * C * H;
  Taps<A> ty(h, H, a.align_corners), tx(w, W, a.align_corners);
  const A scale = static_cast<A>(a.scale);
  parallel_ranges(rows, useful_threads(threads, rows, W), [&](int64_t begin, int64_t end) {
    Scratch<A> low_row(w), high_row(w), blended(w), add_row(W), out_row(W);
    for (int64_t row = begin; row < end; ++row) {
      const int64_t n = row / (C * H), c = row / H % C, y = row % H;
      const T* plane = a.input.data + n * a.input.stride[0] + c * a.input.stride[1];
      const A* low = read_row(plane + ty.low[y] * a.input.stride[2], a.input.stride[3], w, low_row);
      const A* high = read_row(plane + ty.high[y] * a.input.stride[2], a.input.stride[3], w, high_row);
      const A fy = ty.weight[y];
      A* __restrict__ between = blended;
      for (int64_t x = 0; x < w; ++x) between[x] = scale * ((1 - fy) * low[x] + fy * high[x]);

      A* __restrict__ out = sizeof(T) == sizeof(A) ? reinterpret_cast<A*>(a.out + row * W) : static_cast<A*>(out_row);
      const int32_t *left = tx.low, *right = tx.high;
      const A* fx = tx.weight;
      if (a.add.data != nullptr) {
        const A* add = read_row(a.add.data + n * a.add.stride[0] + c * a.add.stride[1] + y * a.add.stride[2],
                                a.add.stride[3], W, add_row);
        for (int64_t x = 0; x < W; ++x) out[x] = add[x] + (1 - fx[x]) * between[left[x]] + fx[x] * between[right[x]];
      } else {
        for (int64_t x = 0; x < W; ++x) out[x] = (1 - fx[x]) * between[left[x]] + fx[x] * between[right[x]];
      }
      if constexpr (sizeof(T) != sizeof(A)) write_row(out, W, a.out + row * W);
    }
  });
}

template <class T>
void resize_backward(const ResizeBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t C = a.grad.size[1], H = a.grad.size[2], W = a.grad.size[3], h = a.height, w = a.width;
  const int64_t rows = a.grad.size[0] * C * h;
  Taps<A> ty(h, H, a.align_corners), tx(w, W, a.align_corners);
  // Taps ascend, so the output rows that read input row i are contiguous: from first[i] up to first[i + 2].
  Scratch<int64_t> first(h + 2);
  for (int64_t i = 0, y = 0; i < h + 2; ++i) {
    while (y < H && ty.low[y] < i - 1) ++y;
    first[i] = y;
  }
  const A scale = static_cast<A>(a.scale);
  parallel_ranges(rows, useful_threads(threads, a.grad.size[0], C, H, W, 2), [&](int64_t begin, int64_t end) {
    Scratch<A> grad_row(W), collected(W), out_row(w);
    for (int64_t row = begin; row < end; ++row) {
      const int64_t n = row / (C * h), c = row / h % C, i = row % h;
      const T* plane = a.grad.data + n * a.grad.stride[0] + c * a.grad.stride[1];
      A* __restrict__ sum = collected;
      for (int64_t x = 0; x < W; ++x) sum[x] = 0;
      for (int64_t y = first[i]; y < first[i + 2]; ++y) {
        const A weight = (ty.low[y] == i ? 1 - ty.weight[y] : 0) + (ty.high[y] == i ? ty.weight[y] : 0);
        const A* grad = read_row(plane + y * a.grad.stride[2], a.grad.stride[3], W, grad_row);
        for (int64_t x = 0; x < W; ++x) sum[x] += weight * grad[x];
      }
      for (int64_t j = 0; j < w; ++j) out_row[j] = 0;
      for (int64_t x = 0; x < W; ++x) {
        out_row[tx.low[x]] += (1 - tx.weight[x]) * sum[x];
        out_row[tx.high[x]] += tx.weight[x] * sum[x];
      }
      for (int64_t j = 0; j < w; ++j) a.grad_input[row * w + j] = from_accumulator<T>(scale * out_row[j]);
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(resize, Resize)
ANYNET_INSTANTIATE_KERNEL(resize_backward, ResizeBackward)

}  // namespace anynet::ANYNET_ISA
