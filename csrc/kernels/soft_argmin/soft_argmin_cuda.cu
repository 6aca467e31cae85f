// One thread per 16 bytes of a row (per pixel, where rows are not aligned), so that every load and store of a warp is
// one stretch of memory. The forward pass reads the costs once (online softmax); the backward pass reads them a second
// time, from the cache.
#include <cmath>

#include "../common/cuda.h"
#include "soft_argmin.h"

namespace anynet::cuda {
namespace {

constexpr int threads_per_block = 128;

/// Softmax of -cost, cost by cost: sums are relative to the lowest cost so far.
template <class A>
struct OnlineSoftmin {
  A lowest = static_cast<A>(INFINITY), sum = 0, weighted = 0;

  ANYNET_DEVICE void add(A cost, A index) {
    const A e = exp(cost == lowest ? 0 : -fabs(cost - lowest));
    if (cost < lowest) {
      sum = sum * e + 1;
      weighted = weighted * e + index;
      lowest = cost;
    } else {
      sum += e;
      weighted += e * index;
    }
  }

  /// The expected index. NaN if any cost was NaN or -infinity, or all were infinite: as softmax says.
  ANYNET_DEVICE A mean() const { return weighted / sum + (lowest - lowest); }
};

/// Where a thread works: N consecutive pixels of one row.
struct Place {
  int64_t n, y, x;
};

template <int N>
ANYNET_DEVICE bool find_place(const int64_t* size, Place& place) {
  const int64_t packs = size[3] / N, i = static_cast<int64_t>(blockIdx.x) * threads_per_block + threadIdx.x;
  place = {i / packs / size[2], i / packs % size[2], i % packs * N};
  return place.n < size[0];
}

template <class T, int N>
ANYNET_DEVICE void scan(const View4<const T>& cost, const Place& place, OnlineSoftmin<accumulator_t<T>>* softmin) {
  using A = accumulator_t<T>;
  const T* c = cost.data + place.n * cost.stride[0] + place.y * cost.stride[2] + place.x * cost.stride[3];
#pragma unroll 4
  for (int64_t k = 0; k < cost.size[1]; ++k) {
    const Pack<T, N> pack = read_pack<T, N>(c + k * cost.stride[1]);
#pragma unroll
    for (int i = 0; i < N; ++i) softmin[i].add(to_accumulator(pack.value[i]), static_cast<A>(k));
  }
}

template <class T, int N>
__global__ void __launch_bounds__(threads_per_block, 4) forward(SoftArgmin<T> a) {
  using A = accumulator_t<T>;
  Place place;
  if (!find_place<N>(a.cost.size, place)) return;
  OnlineSoftmin<A> softmin[N];
  scan<T, N>(a.cost, place, softmin);
  Pack<T, N> pack;
#pragma unroll
  for (int i = 0; i < N; ++i) pack.value[i] = from_accumulator<T>(static_cast<A>(a.first) + softmin[i].mean());
  write_pack(a.out + (place.n * a.cost.size[2] + place.y) * a.cost.size[3] + place.x, pack);
}

template <class T, int N>
__global__ void __launch_bounds__(threads_per_block, 4) backward(SoftArgminBackward<T> a) {
  using A = accumulator_t<T>;
  Place place;
  if (!find_place<N>(a.cost.size, place)) return;
  OnlineSoftmin<A> softmin[N];
  scan<T, N>(a.cost, place, softmin);

  const T* grad = a.grad.data + place.n * a.grad.stride[0] + place.y * a.grad.stride[2];
  A mean[N], scale[N];
#pragma unroll
  for (int i = 0; i < N; ++i) {
    mean[i] = softmin[i].mean();
    scale[i] = -read(grad + (place.x + i) * a.grad.stride[3]) / softmin[i].sum;
  }
  const int64_t* stride = a.cost.stride;
  const int64_t D = a.cost.size[1], plane = a.cost.size[2] * a.cost.size[3];
  const T* c = a.cost.data + place.n * stride[0] + place.y * stride[2] + place.x * stride[3];
  T* out = a.grad_cost + place.n * D * plane + place.y * a.cost.size[3] + place.x;
#pragma unroll 2
  for (int64_t k = 0; k < D; ++k) {
    Pack<T, N> pack = read_pack<T, N>(c + k * stride[1]);
#pragma unroll
    for (int i = 0; i < N; ++i) {
      const A p = exp(softmin[i].lowest - to_accumulator(pack.value[i]));
      pack.value[i] = from_accumulator<T>(scale[i] * p * (static_cast<A>(k) - mean[i]));
    }
    write_pack(out + k * plane, pack);
  }
}

/// A plane without gaps is one long row: fewer rows whose length is no multiple of 16 bytes.
template <class T>
void join_rows(View4<const T>& v) {
  v.size[3] *= v.size[2];
  v.size[2] = 1;
}
template <class T>
bool rows_join(const View4<const T>& v) {
  return v.stride[3] == 1 && v.stride[2] == v.size[3];
}

template <class T>
bool packable(const View4<const T>& cost, const T* out) {
  return rows_aligned(cost) && aligned(out) && cost.size[3] % wide<T> == 0;
}

template <class T>
int64_t blocks(const View4<const T>& cost, int pack) {
  return ceil_div(cost.size[0] * cost.size[2] * (cost.size[3] / pack), threads_per_block);
}

}  // namespace

template <class T>
void soft_argmin(const SoftArgmin<T>& args, Stream stream) {
  SoftArgmin<T> a = args;
  if (rows_join(a.cost)) join_rows(a.cost);
  const bool pack = packable(a.cost, a.out);
  launch("soft_argmin", pack ? forward<T, wide<T>> : forward<T, 1>, blocks(a.cost, pack ? wide<T> : 1),
         threads_per_block, 0, stream, a);
}

template <class T>
void soft_argmin_backward(const SoftArgminBackward<T>& args, Stream stream) {
  SoftArgminBackward<T> a = args;
  if (rows_join(a.cost) && rows_join(a.grad)) {
    join_rows(a.cost);
    join_rows(a.grad);
  }
  const bool pack = packable(a.cost, a.grad_cost);
  launch("soft_argmin_backward", pack ? backward<T, wide<T>> : backward<T, 1>, blocks(a.cost, pack ? wide<T> : 1),
         threads_per_block, 0, stream, a);
}

ANYNET_INSTANTIATE_CUDA_KERNEL(soft_argmin, SoftArgmin)
ANYNET_INSTANTIATE_CUDA_KERNEL(soft_argmin_backward, SoftArgminBackward)

}  // namespace anynet::cuda
