// Soft-argmin: the disparity that a cost volume expects (Kendall et al. 2017, eq. 1; AnyNet paper, section III-B).
//
//   out[n,0,y,x] = sum_k (first + k) p_k,    p = softmax_k(-cost[n,k,y,x])
//
// and, with g the gradient that arrives for out:
//
//   grad_cost[n,k,y,x] = -g p_k ((first + k) - out)
#pragma once

#include "../common/isa.h"
#include "../common/tensor.h"

namespace anynet {

template <class T>
struct SoftArgmin {
  View4<const T> cost;  // [N,D,H,W], any strides
  int64_t first;        // the disparity of cost[:,0]
  T* out;               // [N,1,H,W], contiguous
};

template <class T>
struct SoftArgminBackward {
  View4<const T> grad;  // [N,1,H,W], any strides
  View4<const T> cost;  // [N,D,H,W], any strides
  int64_t first;
  T* grad_cost;  // [N,D,H,W], contiguous
};

ANYNET_DECLARE_KERNEL(soft_argmin, SoftArgmin)
ANYNET_DECLARE_KERNEL(soft_argmin_backward, SoftArgminBackward)

}  // namespace anynet
