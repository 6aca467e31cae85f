// What the CPU and the CUDA operator check and allocate alike.
#pragma once

#include "tensor.h"

namespace anynet::ops {

inline void check_soft_argmin(const Tensor& cost) {
  ANYNET_CHECK(cost.dim() == 4 && cost.size(1) > 0, "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got ",
               shape(cost));
}

inline void check_soft_argmin_backward(const Tensor& grad, const Tensor& cost) {
  check_soft_argmin(cost);
  ANYNET_CHECK(grad.dim() == 4 && grad.size(0) == cost.size(0) && grad.size(1) == 1 && grad.size(2) == cost.size(2) &&
                   grad.size(3) == cost.size(3),
               "soft_argmin_backward: expected grad of shape [N, 1, H, W] for cost ", shape(cost), ", got ",
               shape(grad));
  ANYNET_CHECK(grad.scalar_type() == cost.scalar_type(), "soft_argmin_backward: grad and cost must have one dtype");
}

}  // namespace anynet::ops
