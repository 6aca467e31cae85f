// What the operator checks.
#pragma once

#include "tensor.h"

namespace anynet::ops {

inline void check_resize(const Tensor& input, int64_t height, int64_t width, const std::optional<Tensor>& add) {
  ANYNET_CHECK(input.dim() == 4 && input.size(2) > 0 && input.size(3) > 0,
               "resize: expected input of shape [N, C, H, W] with H, W >= 1, got ", shape(input));
  ANYNET_CHECK(height > 0 && width > 0, "resize: expected height and width >= 1, got ", height, " and ", width);
  if (add.has_value()) check_tensor("resize", "add", *add, {input.size(0), input.size(1), height, width}, input);
}

inline void check_resize_backward(const Tensor& grad, int64_t height, int64_t width) {
  ANYNET_CHECK(grad.dim() == 4 && grad.size(2) > 0 && grad.size(3) > 0,
               "resize_backward: expected grad of shape [N, C, H, W] with H, W >= 1, got ", shape(grad));
  ANYNET_CHECK(height > 0 && width > 0, "resize_backward: expected height and width >= 1, got ", height, " and ",
               width);
}

}  // namespace anynet::ops
