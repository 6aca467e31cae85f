// A warp per row, 32 columns at a time. Both passes are scans of blends, (own, gate): out = own + gate * neighbor with
// own already weighted; two blends in a row are one blend, so that a warp finds 32 results in five steps.
#include <cmath>

#include "../common/cuda.h"
#include "../common/cuda_sampling.h"
#include "occlusion.h"

namespace anynet::cuda {
namespace {

/// The lane `distance` before this one, or, going left, after it.
ANYNET_DEVICE int neighbor(int lane, int distance, bool leftward) {
  return leftward ? lane + distance : lane - distance;
}

/// In every lane the result of its blend, given `before`, the result before the first one of the warp.
template <class A>
ANYNET_DEVICE A blend_scan(A own, A gate, A before, int lane, bool leftward) {
#pragma unroll
  for (int distance = 1; distance < 32; distance *= 2) {
    const int from = neighbor(lane, distance, leftward);
    const A earlier_own = __shfl_sync(all_lanes, own, from & 31),
            earlier_gate = __shfl_sync(all_lanes, gate, from & 31);
    if (from >= 0 && from < 32) {
      own += gate * earlier_own;
      gate *= earlier_gate;
    }
  }
  return own + gate * before;
}

template <class A>
ANYNET_DEVICE A unit(A x) {
  return x < 0 ? 0 : x > 1 ? 1 : x;
}

template <class T>
__global__ void __launch_bounds__(32) fill(FillOcclusions<T> a) {
  const int64_t W = a.width;
  const int lane = threadIdx.x;
  const T* disparity = a.disparity + static_cast<int64_t>(blockIdx.x) * W;
  T* out = a.out + static_cast<int64_t>(blockIdx.x) * W;
  SharedMemory shared;
  T* const occluded = shared.take<T>(static_cast<int>(W));  // each lane reads what it wrote itself, as of `out`

  T leftmost = static_cast<T>(INFINITY), before = read(disparity + W - 1);
  for (int64_t begin = (W - 1) / 32 * 32; begin >= 0; begin -= 32) {
    const int64_t x = begin + lane;
    const T own = x < W ? read(disparity + x) : 0;
    const T p = x < W ? static_cast<T>(x) - own / a.pixel : static_cast<T>(INFINITY);
    T least = p == p ? p : static_cast<T>(INFINITY);
#pragma unroll
    for (int distance = 1; distance < 32; distance *= 2) {
      const T other = __shfl_sync(all_lanes, least, (lane + distance) & 31);
      if (lane + distance < 32 && other < least) least = other;
    }
    if (leftmost < least) least = leftmost;
    const T out_of_view = x < W ? unit(static_cast<T>(-0.5) * p) : 1;  // beyond the row: what is before goes on
    const T result = blend_scan((1 - out_of_view) * own, out_of_view, before, lane, true);
    if (x < W) {
      occluded[x] = unit(static_cast<T>(0.5) * (p - least - static_cast<T>(0.5))) * (1 - out_of_view);
      out[x] = result;
    }
    leftmost = __shfl_sync(all_lanes, least, 0);
    before = __shfl_sync(all_lanes, result, 0);
  }
  before = 0;
  for (int64_t begin = 0; begin < W; begin += 32) {
    const int64_t x = begin + lane;
    const T gate = x > 0 && x < W ? occluded[x] : 0, own = x < W ? out[x] : 0;
    const T result = blend_scan((1 - gate) * own, gate, before, lane, false);
    if (x < W) out[x] = result;
    before = __shfl_sync(all_lanes, result, 31);
  }
}

}  // namespace

template <class T>
void fill_occlusions(const FillOcclusions<T>& a, Stream stream) {
  check_row("fill_occlusions", a.width, 0);
  launch("fill_occlusions", fill<T>, a.rows, 32, shared_bytes<T>(a.width), stream, a);
}

template void fill_occlusions<float>(const FillOcclusions<float>&, Stream);

}  // namespace anynet::cuda
