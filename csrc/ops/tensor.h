// Everything this library needs of PyTorch's stable ABI, in one place: checks, views, dtype dispatch.
#pragma once

#include <torch/csrc/stable/library.h>
#include <torch/csrc/stable/ops.h>
#include <torch/csrc/stable/tensor.h>
#include <torch/headeronly/core/ScalarType.h>

#include <initializer_list>
#include <sstream>
#include <stdexcept>
#include <string>

#include "../kernels/common/tensor.h"

namespace anynet::ops {

using torch::headeronly::ScalarType;
using torch::stable::Tensor;

/// "[1, 3, 4]"
inline std::string shape(const Tensor& t) {
  std::ostringstream s;
  s << '[';
  for (int64_t i = 0; i < t.dim(); ++i) s << (i ? ", " : "") << t.size(i);
  s << ']';
  return s.str();
}

template <class... Parts>
[[noreturn]] void fail(const Parts&... parts) {
  std::ostringstream s;
  (s << ... << parts);
  throw std::runtime_error(s.str());
}

/// ANYNET_CHECK(condition, "warp: image must be ..., got ", shape(image))
#define ANYNET_CHECK(condition, ...) \
  if (!(condition)) ::anynet::ops::fail(__VA_ARGS__)

/// Checks that `t` has the given sizes, and the dtype and device of `first`, the call's first tensor.
inline void check_tensor(const char* op, const char* name, const Tensor& t, std::initializer_list<int64_t> sizes,
                         const Tensor& first) {
  bool fits = t.dim() == static_cast<int64_t>(sizes.size());
  std::string expected;
  int64_t i = 0;
  for (int64_t size : sizes) {
    fits = fits && t.size(i++) == size;
    expected += (expected.empty() ? "" : ", ") + std::to_string(size);
  }
  ANYNET_CHECK(fits, op, ": expected ", name, " of shape [", expected, "], got ", shape(t));
  ANYNET_CHECK(t.scalar_type() == first.scalar_type(), op, ": expected all tensors of one dtype, got ",
               torch::headeronly::toString(first.scalar_type()), " and, for ", name, ", ",
               torch::headeronly::toString(t.scalar_type()));
  ANYNET_CHECK(t.device() == first.device(), op, ": expected all tensors on one device, but ", name, " is on another");
}

/// A 4-D (or Rank-D) strided view of `t`; the caller has checked dim and dtype.
template <class T, int Rank = 4>
View<const T, Rank> view(const Tensor& t) {
  View<const T, Rank> v;
  v.data = static_cast<const T*>(t.const_data_ptr());
  for (int i = 0; i < Rank; ++i) {
    v.size[i] = t.size(i);
    v.stride[i] = t.stride(i);
  }
  return v;
}

/// An uninitialised contiguous tensor of the dtype and device of `like`.
inline Tensor empty_like(const Tensor& like, std::initializer_list<int64_t> sizes) {
  return torch::stable::new_empty(like, torch::headeronly::IntHeaderOnlyArrayRef(sizes));
}

/// The same of the sizes of `like`, whatever its layout.
inline Tensor contiguous_like(const Tensor& like) { return torch::stable::new_empty(like, like.sizes()); }

template <class T>
T* data(const Tensor& t) {
  return static_cast<T*>(t.mutable_data_ptr());
}

inline int num_threads() { return static_cast<int>(torch::stable::get_num_threads()); }

/// Calls body(T{}) where only float and double will do: half types are autocast's job.
template <class Body>
void dispatch_wide(ScalarType dtype, const char* op, const Body& body) {
  switch (dtype) {
    case ScalarType::Float:
      return body(float{});
    case ScalarType::Double:
      return body(double{});
    default:
      fail(op, ": expected tensors of dtype float32 or float64, got ", torch::headeronly::toString(dtype));
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
      fail(op, ": expected a tensor of dtype float32, float64, float16 or bfloat16, got ",
           torch::headeronly::toString(dtype));
  }
}

}  // namespace anynet::ops
