// What the CPU and the CUDA operator check alike.
#pragma once

#include "tensor.h"

namespace anynet::ops {

inline void check_warp(const Tensor& image, const Tensor& disparity) {
  ANYNET_CHECK(image.dim() == 4, "warp: expected image of shape [N, C, H, W], got ", shape(image));
  check_tensor("warp", "disparity", disparity, {image.size(0), 1, image.size(2), image.size(3)}, image);
}

inline void check_warp_backward(const Tensor& grad, const Tensor& image, const Tensor& disparity) {
  check_warp(image, disparity);
  check_tensor("warp_backward", "grad", grad, {image.size(0), image.size(1), image.size(2), image.size(3)}, image);
}

}  // namespace anynet::ops
