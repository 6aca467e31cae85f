// What the operators of the inference graph check.
#pragma once

#include "tensor.h"

namespace anynet::ops {

inline void check_image(const char* op, const Tensor& image) {
  ANYNET_CHECK(image.dim() == 3 && image.size(0) > 0 && image.size(1) > 0 && image.size(2) == 3 &&
                   image.scalar_type() == ScalarType::Byte && image.is_contiguous(),
               op, ": expected a contiguous uint8 image of shape [H, W, 3], got ", shape(image));
}

inline void check_contiguous(const char* op, const char* name, const Tensor& t, int64_t dim) {
  ANYNET_CHECK(t.dim() == dim && t.scalar_type() == ScalarType::Float && t.is_contiguous(), op, ": expected ", name,
               " as contiguous float32 tensor of ", dim, " dimensions, got ", shape(t));
}

inline void check_affine(const char* op, const Tensor& scale, const Tensor& shift, int64_t channels,
                         const Tensor& first) {
  check_contiguous(op, "scale", scale, 1);
  check_contiguous(op, "shift", shift, 1);
  check_tensor(op, "scale", scale, {channels}, first);
  check_tensor(op, "shift", shift, {channels}, first);
}

}  // namespace anynet::ops
