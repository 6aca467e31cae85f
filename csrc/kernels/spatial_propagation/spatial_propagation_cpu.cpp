#include <cmath>

#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "../common/transpose.h"
#include "spatial_propagation.h"

namespace anynet::ANYNET_ISA {

namespace {

/// How a channel is scanned: `steps` lines of `length` elements, in blocks of `block` lines. A line is a column of the
/// image for horizontal scans, a row for vertical ones.
struct Scan {
  bool horizontal, descending;
  int64_t steps, length;

  Scan(int64_t H, int64_t W, int direction)
      : horizontal(direction < 2),
        descending(direction % 2 == 1),
        steps(horizontal ? W : H),
        length(horizontal ? H : W) {}
};

/// A block of lines in scratch, each with zeros before and after it.
template <class A>
class Lines {
 public:
  static constexpr int64_t block = lanes<A>;

  explicit Lines(int64_t length) : pitch_(round_up(length, lanes<A>) + 2 * lanes<A>), data_(block, pitch_) {
    fill_zero<A>(data_, block * pitch_);
  }

  A* operator[](int64_t i) { return data_ + i * pitch_ + lanes<A>; }

  /// Reads lines [begin, begin + count) of a channel whose rows and columns have these strides.
  template <class T>
  void read(const Scan& scan, const T* p, int64_t row_stride, int64_t column_stride, int64_t begin, int64_t count) {
    Lines& lines = *this;
    if (!scan.horizontal) {
      for (int64_t i = 0; i < count; ++i) {
        copy_row(p + (begin + i) * row_stride, column_stride, scan.length, lines[i]);
      }
      return;
    }
    p += begin * column_stride;
    const int64_t later = (scan.descending ? -2 : 2) * block * column_stride;
    for (int64_t r = 0; r < scan.length; r += block) {
      const int64_t rows = scan.length - r;
      vec<A> tile[block];
      for (int64_t i = 0; i < block && i < rows; ++i) {
        __builtin_prefetch(p + (r + i) * row_stride + later);  // no machine foresees this walk
      }
      if (sizeof(T) == sizeof(A) && column_stride == 1) {
        const LaneRange<A> columns(0, static_cast<int>(count));
        const A* row = reinterpret_cast<const A*>(p + r * row_stride);
#pragma GCC unroll 16
        for (int64_t i = 0; i < block; ++i) tile[i] = i < rows ? load(row + i * row_stride, columns) : vec<A>{};
      } else {
        for (int64_t i = 0; i < block; ++i) {
          tile[i] = i < rows ? read_vector(p + (r + i) * row_stride, column_stride, count) : vec<A>{};
        }
      }
      transpose<A>(tile);
      for (int64_t i = 0; i < block; ++i) store(lines[i] + r, tile[i]);
    }
  }

  /// Writes lines [begin, begin + count) of a contiguous channel.
  template <class T>
  void write(const Scan& scan, T* p, int64_t begin, int64_t count) {
    Lines& lines = *this;
    if (!scan.horizontal) {
      for (int64_t i = 0; i < count; ++i) write_row<T>(lines[i], scan.length, p + (begin + i) * scan.length);
      return;
    }
    for (int64_t r = 0; r < scan.length; r += block) {
      vec<A> tile[block];
      for (int64_t i = 0; i < block; ++i) tile[i] = load(lines[i] + r);
      transpose<A>(tile);
      for (int64_t i = 0; i < block && r + i < scan.length; ++i) {
        write_vector<T>(tile[i], count, p + (r + i) * scan.steps + begin);
      }
    }
  }

 private:
  const int64_t pitch_;
  Scratch<A> data_;
};

/// Reads the three gates of a block of lines, with zeros for those whose neighbor lies outside.
template <class T, class A>
void read_gates(Lines<A>* lines, const Scan& scan, const View<const T, 5>& gates, int64_t n, int64_t c, int64_t begin,
                int64_t count, bool normalize) {
  const int64_t* stride = gates.stride;
  for (int j = 0; j < 3; ++j) {
    const T* p = gates.data + n * stride[0] + j * stride[1] + c * stride[2];
    lines[j].read(scan, p, stride[3], stride[4], begin, count);
  }
  for (int64_t i = 0; i < count; ++i) {
    if (normalize) {
      A *g0 = lines[0][i], *g1 = lines[1][i], *g2 = lines[2][i];
#pragma omp simd
      for (int64_t r = 0; r < scan.length; ++r) {
        const A factor = 1 / (std::abs(g0[r]) + std::abs(g1[r]) + std::abs(g2[r]) + A(1e-8));
        g0[r] *= factor, g1[r] *= factor, g2[r] *= factor;
      }
    }
    lines[0][i][0] = 0;
    lines[2][i][scan.length - 1] = 0;
    if (begin + i == (scan.descending ? scan.steps - 1 : 0)) {
      for (int j = 0; j < 3; ++j) fill_zero<A>(lines[j][i], scan.length);
    }
  }
}

}  // namespace

template <class T>
void spatial_propagation(const SpatialPropagation<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.input.size[0], C = a.input.size[1], H = a.input.size[2], W = a.input.size[3];
  const Scan scan(H, W, a.direction);
  if (H == 0 || W == 0) return;
  parallel_ranges(N * C, useful_threads(threads, N, C, H, W, 8), [&](int64_t begin, int64_t end) {
    constexpr int64_t block = Lines<A>::block;
    const int64_t R = scan.length;
    Lines<A> input(R), out(R), before(R), gates[3] = {Lines<A>(R), Lines<A>(R), Lines<A>(R)};
    for (int64_t channel = begin; channel < end; ++channel) {
      const int64_t n = channel / C, c = channel % C;
      const int64_t* stride = a.input.stride;
      const A* previous = before[0];
      fill_zero<A>(before[0], R);
      for (int64_t done = 0; done < scan.steps; done += block) {
        const int64_t count = scan.steps - done < block ? scan.steps - done : block;
        const int64_t t = scan.descending ? scan.steps - done - count : done;
        input.read(scan, a.input.data + n * stride[0] + c * stride[1], stride[2], stride[3], t, count);
        read_gates(gates, scan, a.gates, n, c, t, count, a.normalize);
        for (int64_t step = 0; step < count; ++step) {
          const int64_t i = scan.descending ? count - 1 - step : step;
          const A *x = input[i], *g0 = gates[0][i], *g1 = gates[1][i], *g2 = gates[2][i];
          A* const h = out[i];
#pragma omp simd
          for (int64_t r = 0; r < R; ++r) {
            h[r] = (1 - g0[r] - g1[r] - g2[r]) * x[r] + g0[r] * previous[r - 1] + g1[r] * previous[r] +
                   g2[r] * previous[r + 1];
          }
          previous = h;
        }
        // Its line of the block will be written again.
        std::memcpy(before[0], previous, R * sizeof(A));
        previous = before[0];
        out.write(scan, a.out + channel * H * W, t, count);
      }
    }
  });
}

template <class T>
void spatial_propagation_backward(const SpatialPropagationBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.input.size[0], C = a.input.size[1], H = a.input.size[2], W = a.input.size[3];
  const Scan scan(H, W, a.direction);
  if (H == 0 || W == 0) return;
  parallel_ranges(N * C, useful_threads(threads, N, C, H, W, 16), [&](int64_t begin, int64_t end) {
    constexpr int64_t block = Lines<A>::block;
    const int64_t R = scan.length;
    Lines<A> input(R), out(R), e_lines(R), flows(R), gates[3] = {Lines<A>(R), Lines<A>(R), Lines<A>(R)};
    Lines<A> grad_gates[3] = {Lines<A>(R), Lines<A>(R), Lines<A>(R)};
    A* const flow = flows[0];  // what flows back to the line in turn
    for (int64_t channel = begin; channel < end; ++channel) {
      const int64_t n = channel / C, c = channel % C;
      const auto read = [&](Lines<A>& lines, const View4<const T>& v, int64_t t, int64_t count) {
        lines.read(scan, v.data + n * v.stride[0] + c * v.stride[1], v.stride[2], v.stride[3], t, count);
      };
      fill_zero<A>(flow, R);
      // Blocks and lines from the end of the scan to its start.
      for (int64_t left = scan.steps; left > 0;) {
        const int64_t count = left < block ? left : block;
        left -= count;
        const int64_t t = scan.descending ? scan.steps - left - count : left;
        read(input, a.input, t, count);
        read(e_lines, a.grad, t, count);
        read_gates(gates, scan, a.gates, n, c, t, count, false);
        // h of the step before; the first line has none, and reads its own.
        const int64_t first = left == 0;
        const int64_t shift = scan.descending ? 1 : -1;
        read(out, a.out, scan.descending ? t + shift : t + shift + first, count - first);
        for (int64_t step = count - 1; step >= 0; --step) {
          const int64_t i = scan.descending ? count - 1 - step : step;
          const bool has_before = left + step > 0;
          const A* h = out[has_before ? (scan.descending ? i : i - first) : 0];
          const A *x = input[i], *g0 = gates[0][i], *g1 = gates[1][i], *g2 = gates[2][i];
          A *const e = e_lines[i], *const d0 = grad_gates[0][i], *const d1 = grad_gates[1][i],
                   *const d2 = grad_gates[2][i];
          for (int64_t r = 0; r < R; ++r) e[r] += flow[r];
#pragma omp simd
          for (int64_t r = 0; r < R; ++r) {
            flow[r] = g0[r + 1] * e[r + 1] + g1[r] * e[r] + g2[r - 1] * e[r - 1];
            d0[r] = e[r] * (h[r - 1] - x[r]);
            d1[r] = e[r] * (h[r] - x[r]);
            d2[r] = e[r] * (h[r + 1] - x[r]);
          }
          d0[0] = d2[R - 1] = 0;
          if (!has_before) {
            fill_zero<A>(d0, R);
            fill_zero<A>(d1, R);
            fill_zero<A>(d2, R);
          }
          for (int64_t r = 0; r < R; ++r) e[r] *= 1 - g0[r] - g1[r] - g2[r];
        }
        e_lines.write(scan, a.grad_input + channel * H * W, t, count);
        for (int j = 0; j < 3; ++j) {
          grad_gates[j].write(scan, a.grad_gates + ((n * 3 + j) * C + c) * H * W, t, count);
        }
      }
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(spatial_propagation, SpatialPropagation)
ANYNET_INSTANTIATE_KERNEL(spatial_propagation_backward, SpatialPropagationBackward)

}  // namespace anynet::ANYNET_ISA
