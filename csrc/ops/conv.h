// What the convolutions check, and the shape they tell the kernels.
#pragma once

#include "../kernels/conv/conv.h"
#include "tensor.h"

namespace anynet::ops {

constexpr int64_t conv_channels = 64;  // the most that the operators take, in and out

/// "conv3x3" or "conv3x3x3", for messages.
inline const char* conv_name(int64_t dimensions) { return dimensions == 2 ? "conv3x3" : "conv3x3x3"; }

inline bool is_conv_kernel(const Tensor& weight, int64_t dimensions) {
  if (weight.dim() != dimensions + 2) return false;
  for (int64_t i = 2; i < weight.dim(); ++i) {
    if (weight.size(i) != 3) return false;
  }
  return weight.size(0) >= 1 && weight.size(0) <= conv_channels && weight.size(1) >= 1 &&
         weight.size(1) <= conv_channels;
}

/// The shape for an input of `sizes` ([N,C,(D,)H,W]) and `out_channels`.
inline ConvShape conv_shape(const std::vector<int64_t>& sizes, int64_t out_channels, int64_t stride) {
  const bool volume = sizes.size() == 5;
  return {sizes[0],     sizes[1],       out_channels, volume ? sizes[2] : 1, sizes[sizes.size() - 2],
          sizes.back(), volume ? 3 : 1, stride};
}

inline std::vector<int64_t> sizes(const Tensor& t) {
  std::vector<int64_t> result;
  for (int64_t i = 0; i < t.dim(); ++i) result.push_back(t.size(i));
  return result;
}

/// [N,O,(D',)H',W']
inline std::vector<int64_t> conv_out_sizes(const std::vector<int64_t>& sizes, int64_t out_channels, int64_t stride) {
  std::vector<int64_t> result{sizes[0], out_channels};
  for (size_t i = 2; i < sizes.size(); ++i) result.push_back((sizes[i] - 1) / stride + 1);
  return result;
}

inline void check_conv_input(const Tensor& input, int64_t dimensions, int64_t stride) {
  bool sized = input.dim() == dimensions + 2 && input.size(1) >= 1 && input.size(1) <= conv_channels;
  for (int64_t i = 2; sized && i < input.dim(); ++i) sized = input.size(i) >= 1;
  ANYNET_CHECK(sized, conv_name(dimensions), ": expected input of shape [N, C, ", dimensions == 3 ? "D, " : "",
               "H, W] with C in 1..", conv_channels, " and at least one pixel, got ", shape(input));
  ANYNET_CHECK(stride == 1 || stride == 2, conv_name(dimensions), ": expected stride 1 or 2, got ", stride);
}

inline void check_conv_weight(const Tensor& weight, int64_t dimensions, int64_t in_channels) {
  ANYNET_CHECK(is_conv_kernel(weight, dimensions) && weight.size(1) == in_channels, conv_name(dimensions),
               ": expected weight of shape [O, ", in_channels, dimensions == 3 ? ", 3, 3, 3" : ", 3, 3",
               "] with O in 1..", conv_channels, ", got ", shape(weight));
}

inline void check_conv_vector(const std::optional<Tensor>& vector, const char* name, int64_t dimensions,
                              int64_t channels, ScalarType dtype) {
  if (!vector) return;
  ANYNET_CHECK(vector->dim() == 1 && vector->size(0) == channels && vector->scalar_type() == dtype,
               conv_name(dimensions), ": expected ", name, " of shape [", channels, "] and the input's dtype, got ",
               shape(*vector));
}

}  // namespace anynet::ops
