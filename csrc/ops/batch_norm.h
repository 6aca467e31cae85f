// What batch_norm_relu checks.
#pragma once

#include "tensor.h"

namespace anynet::ops {

inline void check_batch_norm(const char* op, const Tensor& input, const Tensor& weight, const Tensor& bias) {
  ANYNET_CHECK(input.dim() >= 2 && input.size(1) > 0 && input.numel() / input.size(1) > 1, op,
               ": expected input of shape [N, C, ...] with more than one value per channel, got ", shape(input));
  check_tensor(op, "weight", weight, {input.size(1)}, input);
  check_tensor(op, "bias", bias, {input.size(1)}, input);
}

}  // namespace anynet::ops
