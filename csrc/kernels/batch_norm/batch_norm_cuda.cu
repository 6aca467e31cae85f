// A channel is summed in pieces of its planes, one block each, and the pieces by one block per channel: a network that
// trains has few channels of many pixels, and a block per channel, as PyTorch's, would leave most of a GPU idle.
#include <cmath>

#include "../common/cuda.h"
#include "batch_norm.h"

namespace anynet::cuda {
namespace {

constexpr int threads_per_block = 256, warps = threads_per_block / 32;
constexpr int piece_size = 4096;  // so that a second look at a piece finds it in the nearest cache

/// How the channels are divided.
struct Pieces {
  int64_t channels, pixels, per_plane, per_channel, count;

  template <class Args>
  explicit Pieces(const Args& a)
      : channels(a.channels),
        pixels(a.pixels),
        per_plane(ceil_div(a.pixels, piece_size)),
        per_channel(a.batch * per_plane),
        count(a.channels * per_channel) {}

  /// Of a plane's piece.
  ANYNET_DEVICE int64_t length(int64_t part) const {
    const int64_t left = pixels - part * piece_size;
    return left < piece_size ? left : piece_size;
  }
};

/// The block's piece, number `index` channel by channel: `length` elements from `begin` on.
struct Piece {
  int64_t channel, index, begin;
  int length;

  ANYNET_DEVICE explicit Piece(const Pieces& pieces) {
    const int64_t plane = blockIdx.x / pieces.per_plane, part = blockIdx.x % pieces.per_plane;
    channel = plane % pieces.channels;
    index = channel * pieces.per_channel + plane / pieces.channels * pieces.per_plane + part;
    begin = plane * pieces.pixels + part * piece_size;
    length = static_cast<int>(pieces.length(part));
  }
};

/// Calls body(i) for this thread's share of the piece's elements.
template <class Body>
ANYNET_DEVICE void for_each_element(const Piece& piece, const Body& body) {
#pragma unroll 4
  for (int i = static_cast<int>(threadIdx.x); i < piece.length; i += threads_per_block) body(i);
}

/// The sum over the block, in every thread; `A` within a warp, double over the warps.
template <class A>
ANYNET_DEVICE double sum_block(A value, SharedMemory& memory) {
  const int lane = threadIdx.x % 32;
#pragma unroll
  for (int distance = 16; distance > 0; distance /= 2) {
    value += __shfl_sync(all_lanes, value, (lane + distance) & 31);
  }
  double* of_warps = memory.take<double>(warps);
  if (lane == 0) of_warps[threadIdx.x / 32] = value;
  __syncthreads();
  double sum = 0;
#pragma unroll
  for (int i = 0; i < warps; ++i) sum += of_warps[i];
  return sum;
}
constexpr int64_t two_sums = 2 * shared_bytes<double>(warps);

/// The batch norm of a channel.
template <class T>
struct Norm {
  T mean, deviation, scale, bias;

  template <class Args>
  ANYNET_DEVICE Norm(const Args& a, int64_t c)
      : mean(read(a.mean + c)),
        deviation(sqrt(read(a.variance + c) + static_cast<T>(a.eps))),
        scale(read(a.weight + c) / deviation),
        bias(read(a.bias + c)) {}

  ANYNET_DEVICE T operator()(T x) const { return scale * (x - mean) + bias; }
  /// The gradient that comes through the ReLU.
  ANYNET_DEVICE T passed(T x, T grad) const { return (*this)(x) <= 0 ? 0 : grad; }
};

/// Of each piece: the mean, and the sum of squares around it.
template <class T>
__global__ void __launch_bounds__(threads_per_block) gather_statistics(BatchNormRelu<T> a, Pieces pieces) {
  SharedMemory memory;
  const Piece piece(pieces);
  T sum = 0, squares = 0;
  for_each_element(piece, [&](int i) { sum += read(a.input + piece.begin + i); });
  const double mean = sum_block(sum, memory) / piece.length;
  const T middle = static_cast<T>(mean);
  for_each_element(piece, [&](int i) {
    const T away = read(a.input + piece.begin + i) - middle;
    squares += away * away;
  });
  const double around = sum_block(squares, memory);
  if (threadIdx.x != 0) return;
  a.sums[piece.index] = mean;
  a.sums[pieces.count + piece.index] = around - piece.length * (mean - middle) * (mean - middle);
}

/// Sums terms(i, length of piece i) over the pieces of the block's channel.
template <class Terms>
ANYNET_DEVICE double sum_pieces(const Pieces& pieces, SharedMemory& memory, const Terms& terms) {
  double sum = 0;
#pragma unroll 1  // or the division in it spills
  for (int64_t i = threadIdx.x; i < pieces.per_channel; i += threads_per_block) {
    sum += terms(blockIdx.x * pieces.per_channel + i, static_cast<double>(pieces.length(i % pieces.per_plane)));
  }
  return sum_block(sum, memory);
}

template <class T>
__global__ void __launch_bounds__(threads_per_block) combine_statistics(BatchNormRelu<T> a, Pieces pieces) {
  SharedMemory memory;
  const double* squares = a.sums + pieces.count;
  const double count = static_cast<double>(a.batch * a.pixels);
  const double mean = sum_pieces(pieces, memory, [&](int64_t i, double n) { return n * a.sums[i]; }) / count;
  const double variance =
      sum_pieces(pieces, memory,
                 [&](int64_t i, double n) { return squares[i] + n * (a.sums[i] - mean) * (a.sums[i] - mean); }) /
      count;
  if (threadIdx.x != 0) return;
  a.mean[blockIdx.x] = static_cast<T>(mean);
  a.variance[blockIdx.x] = static_cast<T>(variance);
}

template <class T>
__global__ void __launch_bounds__(threads_per_block) normalize(BatchNormRelu<T> a, Pieces pieces) {
  const Piece piece(pieces);
  const Norm<T> norm(a, piece.channel);
  for_each_element(piece, [&](int i) { a.out[piece.begin + i] = relu(norm(read(a.input + piece.begin + i))); });
}

template <class T>
__global__ void __launch_bounds__(threads_per_block) gather_gradients(BatchNormReluBackward<T> a, Pieces pieces) {
  SharedMemory memory;
  const Piece piece(pieces);
  const Norm<T> norm(a, piece.channel);
  T sum = 0, product = 0;
  for_each_element(piece, [&](int i) {
    const T x = read(a.input + piece.begin + i), g = norm.passed(x, read(a.grad + piece.begin + i));
    sum += g;
    product += g * (x - norm.mean);
  });
  const double sums = sum_block(sum, memory), products = sum_block(product, memory);
  if (threadIdx.x != 0) return;
  a.sums[piece.index] = sums;
  a.sums[pieces.count + piece.index] = products;
}

template <class T>
__global__ void __launch_bounds__(threads_per_block) combine_gradients(BatchNormReluBackward<T> a, Pieces pieces) {
  SharedMemory memory;
  const double* products = a.sums + pieces.count;
  const double sum = sum_pieces(pieces, memory, [&](int64_t i, double) { return a.sums[i]; });
  const double product = sum_pieces(pieces, memory, [&](int64_t i, double) { return products[i]; });
  if (threadIdx.x != 0) return;
  a.grad_bias[blockIdx.x] = static_cast<T>(sum);
  a.grad_weight[blockIdx.x] = static_cast<T>(product / Norm<T>(a, blockIdx.x).deviation);
}

template <class T>
__global__ void __launch_bounds__(threads_per_block) spread_gradients(BatchNormReluBackward<T> a, Pieces pieces) {
  const Piece piece(pieces);
  const Norm<T> norm(a, piece.channel);
  const T count = static_cast<T>(a.batch * a.pixels), even = a.grad_bias[piece.channel] / count;
  const T slope = a.grad_weight[piece.channel] / norm.deviation / count;
  for_each_element(piece, [&](int i) {
    const T x = read(a.input + piece.begin + i), g = norm.passed(x, read(a.grad + piece.begin + i));
    a.grad_input[piece.begin + i] = norm.scale * (g - even - slope * (x - norm.mean));
  });
}

/// A block per piece gathers sums, one per channel combines them, and one per piece writes what follows.
template <class Args>
void run(const char* name, void (*gather)(Args, Pieces), void (*combine)(Args, Pieces), void (*write)(Args, Pieces),
         const Args& a, Stream stream) {
  const Pieces pieces(a);
  launch(name, gather, pieces.count, threads_per_block, two_sums, stream, a, pieces);
  launch(name, combine, pieces.channels, threads_per_block, two_sums, stream, a, pieces);
  launch(name, write, pieces.count, threads_per_block, 0, stream, a, pieces);
}

}  // namespace

int64_t batch_norm_sums(int64_t batch, int64_t channels, int64_t pixels) {
  return 2 * channels * batch * ceil_div(pixels, piece_size);
}

template <class T>
void batch_norm_relu(const BatchNormRelu<T>& a, Stream stream) {
  run("batch_norm_relu", gather_statistics<T>, combine_statistics<T>, normalize<T>, a, stream);
}

template <class T>
void batch_norm_relu_backward(const BatchNormReluBackward<T>& a, Stream stream) {
  run("batch_norm_relu_backward", gather_gradients<T>, combine_gradients<T>, spread_gradients<T>, a, stream);
}

template void batch_norm_relu<float>(const BatchNormRelu<float>&, Stream);
template void batch_norm_relu<double>(const BatchNormRelu<double>&, Stream);
template void batch_norm_relu_backward<float>(const BatchNormReluBackward<float>&, Stream);
template void batch_norm_relu_backward<double>(const BatchNormReluBackward<double>&, Stream);

}  // namespace anynet::cuda
