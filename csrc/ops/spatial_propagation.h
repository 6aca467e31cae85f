// What the CPU and the CUDA operator check alike.
#pragma once

#include "tensor.h"

namespace anynet::ops {

inline void check_spatial_propagation(const char* op, const Tensor& input, const Tensor& gates, int64_t direction) {
  ANYNET_CHECK(input.dim() == 4, op, ": expected input of shape [N, C, H, W], got ", shape(input));
  check_tensor(op, "gates", gates, {input.size(0), 3, input.size(1), input.size(2), input.size(3)}, input);
  ANYNET_CHECK(0 <= direction && direction <= 3, op, ": expected direction 0, 1, 2 or 3, got ", direction);
}

inline void check_spatial_propagation_backward(const Tensor& grad, const Tensor& input, const Tensor& gates,
                                               const Tensor& out, int64_t direction) {
  check_spatial_propagation("spatial_propagation_backward", input, gates, direction);
  for (const auto& [name, t] : {std::pair<const char*, const Tensor&>("grad", grad), {"out", out}}) {
    check_tensor("spatial_propagation_backward", name, t, {input.size(0), input.size(1), input.size(2), input.size(3)},
                 input);
  }
}

}  // namespace anynet::ops
