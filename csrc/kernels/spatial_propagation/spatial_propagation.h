// One scan of a three-way spatial propagation network (Liu et al. 2017; AnyNet paper, section III-D).
//
// Written for direction 0, left to right; the others are the same after a flip and/or a transposition. With t the
// position along the scan and r the one across it:
//
//   h[r,t] = (1 - sum_j g_j[r,t]) input[r,t] + sum_j g_j[r,t] h[r+j,t-1],   j = -1, 0, +1
//
// gates[:,0..2] are g_-1, g_0, g_+1. A gate whose neighbor lies outside the image (t = 0 included) counts as 0 in both
// sums. Backward, with e[r,t] the gradient of the loss with respect to h[r,t] (what arrives plus what flows back):
//
//   e[r,t] = grad[r,t] + sum_j g_j[r-j,t+1] e[r-j,t+1]
//   grad_input[r,t] = (1 - sum_j g_j[r,t]) e[r,t]
//   grad_gates_j[r,t] = e[r,t] (h[r+j,t-1] - input[r,t]),   0 where the neighbor lies outside
#pragma once

#include "../common/isa.h"
#include "../common/tensor.h"

namespace anynet {

template <class T>
struct SpatialPropagation {
  View4<const T> input;    // [N,C,H,W], any strides
  View<const T, 5> gates;  // [N,3,C,H,W], any strides
  int direction;           // 0 left to right, 1 right to left, 2 top to bottom, 3 bottom to top
  T* out;                  // [N,C,H,W], contiguous
  bool normalize = false;  // each gate is first divided by the sum of its three's absolute values + 1e-8
};

template <class T>
struct SpatialPropagationBackward {
  View4<const T> grad;     // [N,C,H,W], any strides
  View4<const T> input;    // [N,C,H,W], any strides
  View<const T, 5> gates;  // [N,3,C,H,W], any strides
  View4<const T> out;      // [N,C,H,W], any strides: the forward pass's result
  int direction;
  T* grad_input;  // [N,C,H,W], contiguous
  T* grad_gates;  // [N,3,C,H,W], contiguous
};

ANYNET_DECLARE_KERNEL(spatial_propagation, SpatialPropagation)
ANYNET_DECLARE_KERNEL(spatial_propagation_backward, SpatialPropagationBackward)

}  // namespace anynet
