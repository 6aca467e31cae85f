// What the CPU and the CUDA operator check alike.
#pragma once

#include <optional>

#include "tensor.h"

namespace anynet::ops {

inline void check_cost_volume(const char* op, const Tensor& left, const Tensor& right,
                              const std::optional<Tensor>& disparity, int64_t first, int64_t last) {
  ANYNET_CHECK(left.dim() == 4, op, ": expected left of shape [N, C, H, W], got ", shape(left));
  check_tensor(op, "right", right, {left.size(0), left.size(1), left.size(2), left.size(3)}, left);
  if (disparity.has_value()) {
    check_tensor(op, "disparity", *disparity, {left.size(0), 1, left.size(2), left.size(3)}, left);
  }
  ANYNET_CHECK(first <= last, op, ": expected first <= last, got first ", first, " and last ", last);
}

inline void check_cost_volume_backward(const Tensor& grad, const Tensor& left, const Tensor& right,
                                       const std::optional<Tensor>& disparity, int64_t first, int64_t last) {
  check_cost_volume("cost_volume", left, right, disparity, first, last);
  check_tensor("cost_volume_backward", "grad", grad, {left.size(0), last - first + 1, left.size(2), left.size(3)},
               left);
}

}  // namespace anynet::ops
