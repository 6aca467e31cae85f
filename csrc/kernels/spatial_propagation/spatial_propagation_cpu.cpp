#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "spatial_propagation.h"

namespace anynet::ANYNET_ISA {

namespace {

/// One channel of a tensor, seen along the scan: line t holds the elements p[t * along + r * across].
template <class P>
struct Plane {
  P* p;
  int64_t along, across;

  /// `row` and `column` are the strides of the channel's rows and columns.
  Plane(P* data, int64_t row, int64_t column, int64_t H, int64_t W, int direction)
      : p(data), along(direction < 2 ? column : row), across(direction < 2 ? row : column) {
    if (direction % 2 == 1) {
      p += ((direction < 2 ? W : H) - 1) * along;
      along = -along;
    }
  }
};

template <class T, int Rank>
Plane<const T> plane(const View<const T, Rank>& v, int64_t offset, int direction) {
  return {v.data + offset, v.stride[Rank - 2], v.stride[Rank - 1], v.size[Rank - 2], v.size[Rank - 1], direction};
}

template <class T>
const accumulator_t<T>* read_line(const Plane<const T>& plane, int64_t t, int64_t R, accumulator_t<T>* scratch) {
  return read_row(plane.p + t * plane.along, plane.across, R, scratch);
}

template <class T>
void write_line(const accumulator_t<T>* line, int64_t R, const Plane<T>& plane, int64_t t) {
  for (int64_t r = 0; r < R; ++r) plane.p[t * plane.along + r * plane.across] = from_accumulator<T>(line[r]);
}

}  // namespace

template <class T>
void spatial_propagation(const SpatialPropagation<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.input.size[0], C = a.input.size[1], H = a.input.size[2], W = a.input.size[3];
  const int64_t steps = a.direction < 2 ? W : H, R = a.direction < 2 ? H : W;
  parallel_ranges(N * C, useful_threads(N * C * H * W * 8, threads), [&](int64_t begin, int64_t end) {
    Scratch<A> x_line(R), gate_lines(3 * R), h_line(R), previous_line(R + 2);
    A* const previous = previous_line + 1;
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / C, c = task % C;
      const auto input = plane(a.input, n * a.input.stride[0] + c * a.input.stride[1], a.direction);
      const Plane<T> out(a.out + task * H * W, W, 1, H, W, a.direction);
      const A* g[3];
      for (int64_t t = 0; t < steps; ++t) {
        const A* x = read_line(input, t, R, static_cast<A*>(x_line));
        if (t == 0) {
          std::memcpy(h_line, x, R * sizeof(A));
        } else {
          for (int j = 0; j < 3; ++j) {
            const int64_t offset = n * a.gates.stride[0] + j * a.gates.stride[1] + c * a.gates.stride[2];
            g[j] = read_line(plane(a.gates, offset, a.direction), t, R, gate_lines + j * R);
          }
          for (int64_t r = 0; r < R; ++r) {
            const A g0 = r > 0 ? g[0][r] : 0, g1 = g[1][r], g2 = r < R - 1 ? g[2][r] : 0;
            h_line[r] = (1 - g0 - g1 - g2) * x[r] + g0 * previous[r - 1] + g1 * previous[r] + g2 * previous[r + 1];
          }
        }
        write_line(h_line, R, out, t);
        std::memcpy(previous, h_line, R * sizeof(A));
        previous[-1] = previous[R] = 0;
      }
    }
  });
}

template <class T>
void spatial_propagation_backward(const SpatialPropagationBackward<T>& a, int threads) {
  using A = accumulator_t<T>;
  const int64_t N = a.input.size[0], C = a.input.size[1], H = a.input.size[2], W = a.input.size[3];
  const int64_t steps = a.direction < 2 ? W : H, R = a.direction < 2 ? H : W;
  parallel_ranges(N * C, useful_threads(N * C * H * W * 16, threads), [&](int64_t begin, int64_t end) {
    Scratch<A> x_line(R), grad_line(R), e_line(R), gate_lines(3 * R), padded(R + 2), flow_line(R + 2), results(4 * R);
    A* const h = padded + 1;        // of step t - 1
    A* const flow = flow_line + 1;  // the gradient that flows back to step t - 1
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / C, c = task % C;
      const auto input = plane(a.input, n * a.input.stride[0] + c * a.input.stride[1], a.direction);
      const auto grad = plane(a.grad, n * a.grad.stride[0] + c * a.grad.stride[1], a.direction);
      const auto out = plane(a.out, n * a.out.stride[0] + c * a.out.stride[1], a.direction);
      const Plane<T> grad_input(a.grad_input + task * H * W, W, 1, H, W, a.direction);
      fill_zero<A>(flow_line, R + 2);
      for (int64_t t = steps - 1; t >= 0; --t) {
        const A* x = read_line(input, t, R, static_cast<A*>(x_line));
        const A* arriving = read_line(grad, t, R, static_cast<A*>(grad_line));
        const A* g[3];
        for (int j = 0; j < 3; ++j) {
          const int64_t offset = n * a.gates.stride[0] + j * a.gates.stride[1] + c * a.gates.stride[2];
          g[j] = read_line(plane(a.gates, offset, a.direction), t, R, gate_lines + j * R);
        }
        if (t > 0) {
          const A* before = read_line(out, t - 1, R, h);
          if (before != h) std::memcpy(h, before, R * sizeof(A));
        }
        for (int64_t r = 0; r < R; ++r) e_line[r] = arriving[r] + flow[r];
        fill_zero<A>(flow_line, R + 2);
        for (int64_t r = 0; r < R; ++r) {
          const A e = e_line[r];
          const bool above = t > 0 && r > 0, below = t > 0 && r < R - 1;
          const A g0 = above ? g[0][r] : 0, g1 = t > 0 ? g[1][r] : 0, g2 = below ? g[2][r] : 0;
          results[r] = (1 - g0 - g1 - g2) * e;
          results[R + r] = above ? e * (h[r - 1] - x[r]) : 0;
          results[2 * R + r] = t > 0 ? e * (h[r] - x[r]) : 0;
          results[3 * R + r] = below ? e * (h[r + 1] - x[r]) : 0;
          flow[r - 1] += g0 * e;
          flow[r] += g1 * e;
          flow[r + 1] += g2 * e;
        }
        write_line(results, R, grad_input, t);
        for (int j = 0; j < 3; ++j) {
          const Plane<T> grad_gate(a.grad_gates + ((n * 3 + j) * C + c) * H * W, W, 1, H, W, a.direction);
          write_line(results + (j + 1) * R, R, grad_gate, t);
        }
      }
    }
  });
}

ANYNET_INSTANTIATE_KERNEL(spatial_propagation, SpatialPropagation)
ANYNET_INSTANTIATE_KERNEL(spatial_propagation_backward, SpatialPropagationBackward)

}  // namespace anynet::ANYNET_ISA
