// Everything this library needs of PyTorch's stable ABI, in one place: checks, views, dtype dispatch.
#pragma once

#include <torch/csrc/stable/library.h>
#include <torch/csrc/stable/ops.h>
#include <torch/csrc/stable/tensor.h>
#include <torch/headeronly/core/ScalarType.h>

#include <initializer_list>
#include <iterator>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "../kernels/common/affine_relu.h"
#include "../kernels/common/tensor.h"

namespace anynet::ops {

using torch::headeronly::ScalarType;
using torch::stable::Tensor;

/// "[1, 3, 4]"
template <class Sizes>
std::string shape(const Sizes& sizes) {
  std::ostringstream s;
  const char* separator = "[";
  for (const int64_t size : sizes) s << std::exchange(separator, ", ") << size;
  s << (sizes.size() == 0 ? "[]" : "]");
  return s.str();
}

inline std::string shape(const Tensor& t) { return shape(t.sizes()); }

/// As PyTorch's users write it.
inline const char* dtype_name(ScalarType dtype) {
  switch (dtype) {
    case ScalarType::Float:
      return "float32";
    case ScalarType::Double:
      return "float64";
    case ScalarType::Half:
      return "float16";
    case ScalarType::BFloat16:
      return "bfloat16";
    case ScalarType::Byte:
      return "uint8";
    case ScalarType::Char:
      return "int8";
    case ScalarType::Short:
      return "int16";
    case ScalarType::Int:
      return "int32";
    case ScalarType::Long:
      return "int64";
    case ScalarType::Bool:
      return "bool";
    default:
      return torch::headeronly::toString(dtype);
  }
}

inline std::string device_name(const Tensor& t) {
  const auto device = t.device();
  if (device.is_cuda()) return "cuda:" + std::to_string(device.index());
  return device.is_cpu() ? "cpu" : "another kind of device";
}

/// "float64 [1, 3, 4]"
inline std::string described(const Tensor& t) { return dtype_name(t.scalar_type()) + (" " + shape(t)); }

/// The same, with strides if these are not a contiguous tensor's.
inline std::string described_layout(const Tensor& t) {
  return described(t) + (t.is_contiguous() ? "" : " of strides " + shape(t.strides()));
}

template <class... Parts>
[[noreturn]] void fail(const Parts&... parts) {
  std::ostringstream s;
  (s << ... << parts);
  throw std::runtime_error(s.str());
}

/// Defines an operator; ANYNET_SCHEMA(m, "warp(Tensor image, Tensor disparity) -> Tensor"). Tags (pt2_compliant_tag)
/// want torch 2.12, and matter only to those who set torch._dynamo.config.only_allow_pt2_compliant_ops.
#define ANYNET_SCHEMA(m, schema) m.def(schema)

/// ANYNET_CHECK(condition, "warp: image must be ..., got ", shape(image))
#define ANYNET_CHECK(condition, ...) \
  if (!(condition)) ::anynet::ops::fail(__VA_ARGS__)

inline void check_device(const char* op, const char* name, const Tensor& t, const Tensor& first) {
  ANYNET_CHECK(t.device() == first.device(), op, ": expected all tensors on one device, got ", device_name(first),
               " and, for ", name, ", ", device_name(t));
}

/// Checks that `t` has the given sizes, and the dtype and device of `first`, the call's first tensor.
template <class Sizes = std::initializer_list<int64_t>>
void check_tensor(const char* op, const char* name, const Tensor& t, const Sizes& sizes, const Tensor& first) {
  bool fits = t.dim() == static_cast<int64_t>(sizes.size());
  for (int64_t i = 0; fits && i < t.dim(); ++i) fits = t.size(i) == std::data(sizes)[i];
  ANYNET_CHECK(fits, op, ": expected ", name, " of shape ", shape(sizes), ", got ", shape(t));
  ANYNET_CHECK(t.scalar_type() == first.scalar_type(), op, ": expected all tensors of one dtype, got ",
               dtype_name(first.scalar_type()), " and, for ", name, ", ", dtype_name(t.scalar_type()));
  check_device(op, name, t, first);
}

/// Checks that `t` is a tensor as the deployed network's operators take it.
inline void check_contiguous(const char* op, const char* name, const Tensor& t, int64_t dim) {
  ANYNET_CHECK(t.dim() == dim && t.scalar_type() == ScalarType::Float && t.is_contiguous(), op, ": expected ", name,
               " as contiguous float32 tensor of ", dim, " dimensions, got ", described_layout(t));
}

/// Checks that `t` is a float32 vector of so many elements, on the device of `first`.
inline void check_vector(const char* op, const char* name, const Tensor& t, int64_t size, const Tensor& first) {
  check_contiguous(op, name, t, 1);
  check_tensor(op, name, t, {size}, first);
}

inline void check_image(const char* op, const Tensor& image) {
  ANYNET_CHECK(image.dim() == 3 && image.size(0) > 0 && image.size(1) > 0 && image.size(2) == 3 &&
                   image.scalar_type() == ScalarType::Byte && image.is_contiguous(),
               op, ": expected a contiguous uint8 image of shape [H, W, 3], got ", described_layout(image));
}

/// Checks two images of one size on the device of `first`.
inline void check_images(const char* op, const Tensor& left, const Tensor& right, const Tensor& first) {
  check_image(op, left);
  check_image(op, right);
  check_device(op, "left", left, first);
  check_device(op, "right", right, first);
  ANYNET_CHECK(right.size(0) == left.size(0) && right.size(1) == left.size(1), op,
               ": expected images of one size, got ", shape(left), " and ", shape(right));
}

constexpr int64_t max_size = int64_t{1} << 30;  // of a dimension whose indices kernels keep in 32 bits

/// Checks a size that was asked for, in pixels.
inline void check_size(const char* op, int64_t height, int64_t width) {
  ANYNET_CHECK(height > 0 && width > 0 && height <= max_size && width <= max_size, op,
               ": expected a size of at least one pixel and at most 2^30 along each side, got ", height, " x ", width);
}

/// A 4-D (or Rank-D) strided view of `t`; the caller has checked dim and dtype.
template <class T, int Rank = 4>
View<const T, Rank> view(const Tensor& t) {
  // Expanded tensors can have more elements than any memory, and arithmetic on their sizes would overflow.
  ANYNET_CHECK(t.numel() <= int64_t{1} << 48, "expected a tensor of at most 2^48 elements, got ", shape(t));
  View<const T, Rank> v;
  v.data = static_cast<const T*>(t.const_data_ptr());
  for (int i = 0; i < Rank; ++i) {
    v.size[i] = t.size(i);
    v.stride[i] = t.stride(i);
  }
  return v;
}

/// An uninitialized contiguous tensor on the device of `like`, of its dtype or another.
///
/// Straight from PyTorch's allocator: the stable ABI's `new_empty` looks an operator up by its name in every call.
template <class Sizes = std::initializer_list<int64_t>>
Tensor new_tensor(const Tensor& like, const Sizes& sizes, std::optional<ScalarType> dtype = std::nullopt,
                  const char* what = "a result") {
  const int64_t* const size = std::data(sizes);
  std::vector<int64_t> strides(sizes.size());
  uint64_t stride = 1;  // may overflow; PyTorch then refuses
  for (size_t i = sizes.size(); i-- > 0;) {
    strides[i] = static_cast<int64_t>(stride);
    stride *= static_cast<uint64_t>(size[i] > 1 ? size[i] : 1);
  }
  int32_t type, device, index;
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_dtype(like.get(), &type));
  if (dtype) type = torch::stable::detail::to<int32_t>(torch::stable::detail::from(*dtype));
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_device_type(like.get(), &device));
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_device_index(like.get(), &index));
  AtenTensorHandle result;
  const AOTITorchError error =
      aoti_torch_empty_strided(static_cast<int64_t>(sizes.size()), size, strides.data(), type, device, index, &result);
  ANYNET_CHECK(error == AOTI_TORCH_SUCCESS, "expected memory for ", what, " of shape ", shape(sizes), ", got none");
  return Tensor(result);
}

/// One of the sizes and the dtype of `like`, whatever its layout.
inline Tensor new_like(const Tensor& like) { return new_tensor(like, like.sizes()); }

/// The tensor itself if it is contiguous; or a copy.
inline Tensor make_contiguous(const Tensor& t) {
  if (t.is_contiguous()) return t;
  Tensor copy = new_tensor(t, t.sizes(), std::nullopt, "a contiguous copy");
  torch::stable::copy_(copy, t);
  return copy;
}

template <class T>
T* data(const Tensor& t) {
  return static_cast<T*>(t.mutable_data_ptr());
}

template <class T>
const T* const_data(const Tensor& t) {
  return static_cast<const T*>(t.const_data_ptr());
}

/// How many threads a kernel may use: PyTorch's, but one in a process that was forked, where OpenMP's do not exist.
int num_threads();

/// scale, shift [channels] as an epilogue.
inline AffineRelu<float> affine_relu(const char* op, const Tensor& scale, const Tensor& shift, int64_t channels,
                                     const Tensor& first) {
  check_vector(op, "scale", scale, channels, first);
  check_vector(op, "shift", shift, channels, first);
  return {const_data<float>(scale), const_data<float>(shift), channels};
}

/// Calls body(T{}) where only float and double will do: half types are autocast's job.
template <class Body>
void dispatch_wide(ScalarType dtype, const char* op, const Body& body) {
  switch (dtype) {
    case ScalarType::Float:
      return body(float{});
    case ScalarType::Double:
      return body(double{});
    default:
      fail(op, ": expected tensors of dtype float32 or float64, got ", dtype_name(dtype));
  }
}

/// Calls body(T{}) with the kernels' element type for `dtype`.
template <class Body>
void dispatch(ScalarType dtype, const char* op, const Body& body) {
  switch (dtype) {
    case ScalarType::Float:
      return body(float{});
    case ScalarType::Double:
      return body(double{});
    case ScalarType::Half:
      return body(float16{});
    case ScalarType::BFloat16:
      return body(bfloat16{});
    default:
      fail(op, ": expected a tensor of dtype float32, float64, float16 or bfloat16, got ", dtype_name(dtype));
  }
}

}  // namespace anynet::ops
