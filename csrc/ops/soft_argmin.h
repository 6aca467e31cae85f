// What the CPU and the CUDA operator check alike.
#pragma once

#include "tensor.h"

namespace anynet::ops {

inline void check_soft_argmin(const Tensor& cost) {
  ANYNET_CHECK(cost.dim() == 4 && cost.size(1) > 0,
               "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got ", shape(cost));
}

inline void check_soft_argmin_backward(const Tensor& grad, const Tensor& cost) {
  check_soft_argmin(cost);
  check_tensor("soft_argmin_backward", "grad", grad, {cost.size(0), 1, cost.size(2), cost.size(3)}, cost);
}

}  // namespace anynet::ops
