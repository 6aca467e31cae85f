// One launch per call: a block owns a plane (n, c) and walks along the scan; each thread owns one line across it and
// hands its newest value to its two neighbors through shared memory, one barrier per step (two buffers in turn).
// Threads read whole 32-byte sectors of their line where it is contiguous (left to right), neighboring threads
// neighboring elements otherwise, and always a few steps ahead, so that memory works while the scan waits.
// Planes of more than 512 lines (backward: 384) go through a plainer kernel: several lines per thread, nothing read
// ahead.
#include <cmath>

#include "../common/cuda.h"
#include "spatial_propagation.h"

namespace anynet::cuda {
namespace {

/// A tensor of planes, seen along the scan: step t of line r of plane (n, c) is data[n*.. + c*.. + t*along + r*across].
template <class P>
struct Planes {
  P* data;
  int64_t n, c, along, across;

  ANYNET_DEVICE P* line(int64_t at_n, int64_t at_c, int64_t r) const { return data + at_n * n + at_c * c + r * across; }
};

/// Turns rows and columns into lines and steps; `steps` is the number of steps.
template <class P>
Planes<P> along_scan(P* data, int64_t n, int64_t c, int64_t row, int64_t column, int64_t steps, int direction) {
  Planes<P> planes{data, n, c, direction < 2 ? column : row, direction < 2 ? row : column};
  if (direction % 2 == 1) {
    planes.data += (steps - 1) * planes.along;
    planes.along = -planes.along;
  }
  return planes;
}

template <class T>
struct Forward {
  Planes<const T> input, gate[3];
  Planes<T> out;
  int64_t C, lines, steps;
  bool normalize;
};

template <class T>
struct Backward {
  Planes<const T> grad, input, out, gate[3];
  Planes<T> grad_input, grad_gate[3];
  int64_t C, lines, steps;
};

constexpr int most_lines = 512, most_lines_backward = 384;  // of the kernels with one thread per line
constexpr int threads_of_many = 512;                        // of the others

// ------------------------------------------------------------------------------------------- reading and writing ahead
/// N steps of a line, in the order of the scan, from step t on. Packs: contiguous, aligned, steps a multiple of N.
template <class T, int N, bool Packs>
ANYNET_DEVICE void read_steps(const T* line, int64_t along, int64_t t, int64_t steps, T (&to)[N]) {
  if constexpr (Packs) {
    constexpr int pack_size = N < wide<T> ? N : wide<T>;
#pragma unroll
    for (int i = 0; i < N; i += pack_size) {
      const int64_t begin = (t + i) * along;
      const Pack<T, pack_size> pack = read_pack<T, pack_size>(line + (along > 0 ? begin : begin - (pack_size - 1)));
#pragma unroll
      for (int j = 0; j < pack_size; ++j) to[i + j] = along > 0 ? pack.value[j] : pack.value[pack_size - 1 - j];
    }
  } else {
#pragma unroll
    for (int i = 0; i < N; ++i) {
      if (t + i < steps) to[i] = read_raw(line + (t + i) * along);
    }
  }
}

template <class T, int N, bool Packs>
ANYNET_DEVICE void write_steps(T* line, int64_t along, int64_t t, int64_t steps, const T (&from)[N]) {
  if constexpr (Packs) {
    constexpr int pack_size = N < wide<T> ? N : wide<T>;
#pragma unroll
    for (int i = 0; i < N; i += pack_size) {
      Pack<T, pack_size> pack;
#pragma unroll
      for (int j = 0; j < pack_size; ++j) pack.value[j] = along > 0 ? from[i + j] : from[i + pack_size - 1 - j];
      const int64_t begin = (t + i) * along;
      write_pack(line + (along > 0 ? begin : begin - (pack_size - 1)), pack);
    }
  } else {
#pragma unroll
    for (int i = 0; i < N; ++i) {
      if (t + i < steps) line[(t + i) * along] = from[i];
    }
  }
}

/// What each of a pixel's gates is multiplied by.
template <class A>
ANYNET_DEVICE A norm(bool normalize, A before, A same, A after) {
  return normalize ? 1 / (fabs(before) + fabs(same) + fabs(after) + static_cast<A>(1e-8)) : 1;
}

/// Gates of one step; those without a neighbor are 0.
template <class A>
struct Gates {
  A before, same, after;

  ANYNET_DEVICE Gates(A before, A same, A after, int64_t t, int64_t r, int64_t lines)
      : before(t > 0 && r > 0 ? before : 0), same(t > 0 ? same : 0), after(t > 0 && r < lines - 1 ? after : 0) {}

  ANYNET_DEVICE A rest() const { return 1 - before - same - after; }
};

/// Two lines in shared memory with a 0 before and after each; one is read while the other is written. The constructor
/// clears them: a barrier must follow.
template <class A>
struct Exchange {
  A *even, *odd;

  ANYNET_DEVICE Exchange(SharedMemory& shared, int64_t lines)
      : even(clear(shared, static_cast<int>(lines) + 2)), odd(clear(shared, static_cast<int>(lines) + 2)) {}

  ANYNET_DEVICE A* buffer(int i) const { return i % 2 == 0 ? even : odd; }

  ANYNET_DEVICE static A* clear(SharedMemory& shared, int size) {
    A* line = shared.take<A>(size);
    for (int i = threadIdx.x; i < size; i += blockDim.x) line[i] = 0;
    return line + 1;
  }
  static int64_t bytes(int64_t lines) { return 2 * shared_bytes<A>(lines + 2); }
};

// ------------------------------------------------------------------------------------------------------------ forward
/// Steps read at once: as many as registers allow.
template <class T, bool Packs>
constexpr int forward_steps = (sizeof(T) == 8 ? 4 : 8) / (Packs ? 1 : 2);

template <class T, bool Packs>
__global__ void __launch_bounds__(most_lines, 1) forward(Forward<T> a) {
  using A = accumulator_t<T>;
  constexpr int N = forward_steps<T, Packs>;
  const int64_t n = blockIdx.x / a.C, c = blockIdx.x % a.C;
  const int r = threadIdx.x;
  const bool real = r < a.lines;
  const int line = real ? r : 0;  // the others idle along
  const T* input = a.input.line(n, c, line);
  const T* gate[3] = {a.gate[0].line(n, c, line), a.gate[1].line(n, c, line), a.gate[2].line(n, c, line)};
  T* out = a.out.line(n, c, line);

  SharedMemory shared;
  const Exchange<A> h(shared, a.lines);
  __syncthreads();

  T x[N], g[3][N], next_x[N], next_g[3][N], result[N];
  read_steps<T, N, Packs>(input, a.input.along, 0, a.steps, next_x);
#pragma unroll
  for (int j = 0; j < 3; ++j) read_steps<T, N, Packs>(gate[j], a.gate[j].along, 0, a.steps, next_g[j]);
  A value = 0;
  for (int64_t begin = 0; begin < a.steps; begin += N) {
#pragma unroll
    for (int i = 0; i < N; ++i) {
      x[i] = next_x[i];
#pragma unroll
      for (int j = 0; j < 3; ++j) g[j][i] = next_g[j][i];
    }
    if (begin + N < a.steps) {
      read_steps<T, N, Packs>(input, a.input.along, begin + N, a.steps, next_x);
#pragma unroll
      for (int j = 0; j < 3; ++j) read_steps<T, N, Packs>(gate[j], a.gate[j].along, begin + N, a.steps, next_g[j]);
    }
#pragma unroll
    for (int i = 0; i < N; ++i) {
      const int64_t t = begin + i;
      if (!Packs && t >= a.steps) break;
      const A g0 = to_accumulator(g[0][i]), g1 = to_accumulator(g[1][i]), g2 = to_accumulator(g[2][i]);
      const A gain = norm(a.normalize, g0, g1, g2);
      const Gates<A> gates(gain * g0, gain * g1, gain * g2, t, r, a.lines);
      const A* previous = h.buffer(i + 1);
      if (real) {
        value = gates.rest() * to_accumulator(x[i]) + gates.before * previous[r - 1] + gates.same * value +
                gates.after * previous[r + 1];
        h.buffer(i)[r] = value;
      }
      result[i] = from_accumulator<T>(value);
      __syncthreads();
    }
    if (real) write_steps<T, N, Packs>(out, a.out.along, begin, a.steps, result);
  }
}

template <class T>
__global__ void __launch_bounds__(threads_of_many, 1) forward_many(Forward<T> a) {
  using A = accumulator_t<T>;
  const int64_t n = blockIdx.x / a.C, c = blockIdx.x % a.C;
  SharedMemory shared;
  const Exchange<A> h(shared, a.lines);
  __syncthreads();
  for (int64_t t = 0; t < a.steps; ++t) {
    const A* previous = h.buffer(t + 1);
    for (int r = threadIdx.x; r < a.lines; r += blockDim.x) {
      const auto gate = [&](int j) { return read(a.gate[j].line(n, c, r) + t * a.gate[j].along); };
      const A g0 = gate(0), g1 = gate(1), g2 = gate(2), gain = norm(a.normalize, g0, g1, g2);
      const Gates<A> gates(gain * g0, gain * g1, gain * g2, t, r, a.lines);
      const A value = gates.rest() * read(a.input.line(n, c, r) + t * a.input.along) + gates.before * previous[r - 1] +
                      gates.same * previous[r] + gates.after * previous[r + 1];
      h.buffer(t)[r] = value;
      a.out.line(n, c, r)[t * a.out.along] = from_accumulator<T>(value);
    }
    __syncthreads();
  }
}

// ----------------------------------------------------------------------------------------------------------- backward
// Going down from the last step, line r needs from its neighbors: the gradient that flows to it from step t + 1, and
// h at step t - 1. All three are in shared memory when a step begins.
template <class A>
struct BackwardExchange {
  Exchange<A> to_before, to_after;  // what line r sends to lines r - 1 and r + 1
  Exchange<A> h;

  ANYNET_DEVICE BackwardExchange(SharedMemory& shared, int64_t lines)
      : to_before(shared, lines), to_after(shared, lines), h(shared, lines) {}
  static int64_t bytes(int64_t lines) { return 3 * Exchange<A>::bytes(lines); }
};

/// What one step of one line computes.
template <class A>
struct BackwardStep {
  A input, gate[3], flow;  // `flow` goes to the same line at t - 1

  /// Reads buffer `from` of `exchange` and writes what the neighbors need to the other one.
  ANYNET_DEVICE BackwardStep(const BackwardExchange<A>& exchange, int from, int r, int64_t t, int64_t lines, A arriving,
                             const Gates<A>& gates, A x, A h) {
    const A e = arriving + exchange.to_after.buffer(from)[r - 1] + exchange.to_before.buffer(from)[r + 1];
    input = gates.rest() * e;
    gate[0] = t > 0 && r > 0 ? e * (exchange.h.buffer(from)[r - 1] - x) : 0;
    gate[1] = t > 0 ? e * (h - x) : 0;
    gate[2] = t > 0 && r < lines - 1 ? e * (exchange.h.buffer(from)[r + 1] - x) : 0;
    flow = gates.same * e;
    exchange.to_before.buffer(from + 1)[r] = gates.before * e;
    exchange.to_after.buffer(from + 1)[r] = gates.after * e;
  }
};

template <class T>
constexpr int backward_steps = sizeof(T) == 8 ? 2 : 4;

template <class T, bool Packs>
__global__ void __launch_bounds__(most_lines_backward, 1) backward(Backward<T> a) {
  using A = accumulator_t<T>;
  constexpr int N = backward_steps<T>;
  const int64_t n = blockIdx.x / a.C, c = blockIdx.x % a.C;
  const int r = threadIdx.x;
  const bool real = r < a.lines;
  const int line = real ? r : 0;
  const T* grad = a.grad.line(n, c, line);
  const T* input = a.input.line(n, c, line);
  const T* out = a.out.line(n, c, line);
  const T* gate[3] = {a.gate[0].line(n, c, line), a.gate[1].line(n, c, line), a.gate[2].line(n, c, line)};
  T* grad_input = a.grad_input.line(n, c, line);
  T* grad_gate[3] = {a.grad_gate[0].line(n, c, line), a.grad_gate[1].line(n, c, line), a.grad_gate[2].line(n, c, line)};

  SharedMemory shared;
  const BackwardExchange<A> exchange(shared, a.lines);
  __syncthreads();
  if (real && a.steps > 1) exchange.h.buffer(a.steps - 1)[r] = read(out + (a.steps - 2) * a.out.along);

  T e[N], x[N], h[N], g[3][N], next_e[N], next_x[N], next_h[N], next_g[3][N];
  const auto read_next = [&](int64_t begin) {
    read_steps<T, N, Packs>(grad, a.grad.along, begin, a.steps, next_e);
    read_steps<T, N, Packs>(input, a.input.along, begin, a.steps, next_x);
    read_steps<T, N, Packs>(out, a.out.along, begin, a.steps, next_h);
#pragma unroll
    for (int j = 0; j < 3; ++j) read_steps<T, N, Packs>(gate[j], a.gate[j].along, begin, a.steps, next_g[j]);
  };
  const int64_t last = (a.steps - 1) / N * N;
  read_next(last);
  A flow = 0;
  __syncthreads();
  for (int64_t begin = last; begin >= 0; begin -= N) {
#pragma unroll
    for (int i = 0; i < N; ++i) {
      e[i] = next_e[i];
      x[i] = next_x[i];
      h[i] = next_h[i];
#pragma unroll
      for (int j = 0; j < 3; ++j) g[j][i] = next_g[j][i];
    }
    if (begin > 0) read_next(begin - N);
    T result[N], gate_result[3][N];
#pragma unroll
    for (int i = N - 1; i >= 0; --i) {
      const int64_t t = begin + i;
      if (!Packs && t >= a.steps) continue;
      const Gates<A> gates(to_accumulator(g[0][i]), to_accumulator(g[1][i]), to_accumulator(g[2][i]), t, r, a.lines);
      if (real) {
        const T before = i > 0 ? h[i > 0 ? i - 1 : 0] : next_h[N - 1];  // h at t - 1; unused at t = 0
        const BackwardStep<A> step(exchange, i, r, t, a.lines, to_accumulator(e[i]) + flow, gates, to_accumulator(x[i]),
                                   to_accumulator(before));
        flow = step.flow;
        if (t > 1) {
          const T two_before = i > 1 ? h[i > 1 ? i - 2 : 0] : next_h[N - 2 + i];
          exchange.h.buffer(i + 1)[r] = to_accumulator(two_before);
        }
        result[i] = from_accumulator<T>(step.input);
#pragma unroll
        for (int j = 0; j < 3; ++j) gate_result[j][i] = from_accumulator<T>(step.gate[j]);
      }
      __syncthreads();
    }
    if (real) {
      write_steps<T, N, Packs>(grad_input, a.grad_input.along, begin, a.steps, result);
#pragma unroll
      for (int j = 0; j < 3; ++j) {
        write_steps<T, N, Packs>(grad_gate[j], a.grad_gate[j].along, begin, a.steps, gate_result[j]);
      }
    }
  }
}

template <class T>
__global__ void __launch_bounds__(threads_of_many, 1) backward_many(Backward<T> a) {
  using A = accumulator_t<T>;
  const int64_t n = blockIdx.x / a.C, c = blockIdx.x % a.C;
  SharedMemory shared;
  const BackwardExchange<A> exchange(shared, a.lines);
  A* const flow = shared.take<A>(static_cast<int>(a.lines));
  __syncthreads();
  for (int r = threadIdx.x; r < a.lines; r += blockDim.x) {
    flow[r] = 0;
    if (a.steps > 1) exchange.h.buffer(a.steps - 1)[r] = read(a.out.line(n, c, r) + (a.steps - 2) * a.out.along);
  }
  __syncthreads();
  for (int64_t t = a.steps - 1; t >= 0; --t) {
    const int from = static_cast<int>(t % 2);
    for (int r = threadIdx.x; r < a.lines; r += blockDim.x) {
      const auto gate = [&](int j) { return read(a.gate[j].line(n, c, r) + t * a.gate[j].along); };
      const Gates<A> gates(gate(0), gate(1), gate(2), t, r, a.lines);
      const BackwardStep<A> step(exchange, from, r, t, a.lines, read(a.grad.line(n, c, r) + t * a.grad.along) + flow[r],
                                 gates, read(a.input.line(n, c, r) + t * a.input.along), exchange.h.buffer(from)[r]);
      flow[r] = step.flow;
      if (t > 1) exchange.h.buffer(from + 1)[r] = read(a.out.line(n, c, r) + (t - 2) * a.out.along);
      a.grad_input.line(n, c, r)[t * a.grad_input.along] = from_accumulator<T>(step.input);
      for (int j = 0; j < 3; ++j)
        a.grad_gate[j].line(n, c, r)[t * a.grad_gate[j].along] = from_accumulator<T>(step.gate[j]);
    }
    __syncthreads();
  }
}

// --------------------------------------------------------------------------------------------------------------- host
template <class T>
Planes<const T> input_planes(const View4<const T>& v, int64_t steps, int direction) {
  return along_scan(v.data, v.stride[0], v.stride[1], v.stride[2], v.stride[3], steps, direction);
}
template <class T>
Planes<const T> gate_planes(const View<const T, 5>& v, int j, int64_t steps, int direction) {
  return along_scan(v.data + j * v.stride[1], v.stride[0], v.stride[2], v.stride[3], v.stride[4], steps, direction);
}
/// A contiguous result with `tensors` tensors [C,H,W] per n, of which this is number j.
template <class T>
Planes<T> result_planes(T* data, const int64_t* size, int tensors, int j, int64_t steps, int direction) {
  const int64_t plane = size[2] * size[3], all = size[1] * plane;
  return along_scan(data + j * all, tensors * all, plane, size[3], int64_t{1}, steps, direction);
}

/// Whether lines can be read in packs of 16 bytes: contiguous along the scan, every line aligned.
template <class T>
bool packs(const int64_t* size, int direction, std::initializer_list<bool> rows_are_aligned) {
  bool all = direction < 2 && size[3] % forward_steps<T, true> == 0;
  for (bool one : rows_are_aligned) all = all && one;
  return all;
}

dim3 threads_for(int64_t lines) { return static_cast<unsigned>((lines + 31) / 32 * 32); }

}  // namespace

template <class T>
void spatial_propagation(const SpatialPropagation<T>& args, Stream stream) {
  const int64_t* size = args.input.size;
  const int d = args.direction;
  const int64_t lines = d < 2 ? size[2] : size[3], steps = d < 2 ? size[3] : size[2];
  if (lines == 0 || steps == 0) return;
  Forward<T> a;
  a.input = input_planes(args.input, steps, d);
  for (int j = 0; j < 3; ++j) a.gate[j] = gate_planes(args.gates, j, steps, d);
  a.out = result_planes(args.out, size, 1, 0, steps, d);
  a.C = size[1];
  a.lines = lines;
  a.steps = steps;
  a.normalize = args.normalize;
  const int64_t shared = Exchange<accumulator_t<T>>::bytes(lines);
  if (lines > most_lines) {
    launch("spatial_propagation", forward_many<T>, size[0] * size[1], threads_of_many, shared, stream, a);
  } else {
    const bool p = packs<T>(size, d, {rows_aligned(args.input), rows_aligned(args.gates), aligned(args.out)});
    launch("spatial_propagation", p ? forward<T, true> : forward<T, false>, size[0] * size[1], threads_for(lines),
           shared, stream, a);
  }
}

template <class T>
void spatial_propagation_backward(const SpatialPropagationBackward<T>& args, Stream stream) {
  using A = accumulator_t<T>;
  const int64_t* size = args.input.size;
  const int d = args.direction;
  const int64_t lines = d < 2 ? size[2] : size[3], steps = d < 2 ? size[3] : size[2];
  if (lines == 0 || steps == 0) return;
  Backward<T> a;
  a.grad = input_planes(args.grad, steps, d);
  a.input = input_planes(args.input, steps, d);
  a.out = input_planes(args.out, steps, d);
  a.grad_input = result_planes(args.grad_input, size, 1, 0, steps, d);
  for (int j = 0; j < 3; ++j) {
    a.gate[j] = gate_planes(args.gates, j, steps, d);
    a.grad_gate[j] = result_planes(args.grad_gates, size, 3, j, steps, d);
  }
  a.C = size[1];
  a.lines = lines;
  a.steps = steps;
  const int64_t shared = BackwardExchange<A>::bytes(lines);
  if (lines > most_lines_backward) {
    launch("spatial_propagation_backward", backward_many<T>, size[0] * size[1], threads_of_many,
           shared + shared_bytes<A>(lines), stream, a);
  } else {
    const bool p = packs<T>(size, d,
                            {rows_aligned(args.grad), rows_aligned(args.input), rows_aligned(args.out),
                             rows_aligned(args.gates), aligned(args.grad_input), aligned(args.grad_gates)});
    launch("spatial_propagation_backward", p ? backward<T, true> : backward<T, false>, size[0] * size[1],
           threads_for(lines), shared, stream, a);
  }
}

ANYNET_INSTANTIATE_CUDA_KERNEL(spatial_propagation, SpatialPropagation)
ANYNET_INSTANTIATE_CUDA_KERNEL(spatial_propagation_backward, SpatialPropagationBackward)

}  // namespace anynet::cuda
