// L1 cost volume, optionally around a disparity map (AnyNet paper, sections III-B and III-C, Fig. 3).
//
//   out[n,k,y,x] = sum_c | left[n,c,y,x] - right[n,c,y,p_k] |,   p_k = x - disparity[n,0,y,x] - (first + k)
//
// right is sampled as in warp.h: linear between pixels, 0 outside, NaN where disparity is NaN. Without disparity every
// p_k is an integer. With g the gradient that arrives for out, s = sign(left - right[p_k]) (0 at 0 and at NaN),
// i = floor(p_k):
//
//   grad_left[n,c,y,x] = sum_k g s
//   grad_right[n,c,y,j] = -sum over x, k of g s max(0, 1 - |p_k(x) - j|)
//   grad_disparity[n,0,y,x] = sum_k,c g s (right[i + 1] - right[i])           (right-sided where p_k is an integer)
//
// All positions p_k stay within their row, so one thread owns a row and needs no atomics.
#pragma once

#include "../common/affine_relu.h"
#include "../common/isa.h"
#include "../common/tensor.h"

namespace anynet {

template <class T>
struct CostVolume {
  View4<const T> left;       // [N,C,H,W], any strides
  View4<const T> right;      // [N,C,H,W], any strides
  View4<const T> disparity;  // [N,1,H,W], any strides; data == nullptr means 0 everywhere
  int64_t first;             // the offset of out[:,0]
  int64_t count;             // K, the number of offsets
  T* out;                    // [N,K,H,W], contiguous
  AffineRelu<T> epilogue{};  // of sample n: channel n % channels
};

template <class T>
struct CostVolumeBackward {
  View4<const T> grad;       // [N,K,H,W], any strides
  View4<const T> left;       // [N,C,H,W], any strides
  View4<const T> right;      // [N,C,H,W], any strides
  View4<const T> disparity;  // [N,1,H,W], any strides; data == nullptr means 0 everywhere
  int64_t first;
  int64_t count;
  T* grad_left;       // [N,C,H,W], contiguous
  T* grad_right;      // [N,C,H,W], contiguous
  T* grad_disparity;  // [N,1,H,W], contiguous; nullptr if there is no disparity
};

ANYNET_DECLARE_KERNEL(cost_volume, CostVolume)
ANYNET_DECLARE_KERNEL(cost_volume_backward, CostVolumeBackward)

}  // namespace anynet
