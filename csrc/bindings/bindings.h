#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "../kernels/common/affine_relu.h"
#include "../kernels/common/isa.h"
#include "../kernels/common/tensor.h"

// NumPy's float16 is ours; bfloat16, which NumPy does not have, travels as its bits in uint16.
namespace pybind11::detail {
template <>
struct npy_format_descriptor<anynet::float16> {
  static constexpr auto name = const_name("numpy.float16");
  static pybind11::dtype dtype() { return pybind11::dtype("float16"); }
};
template <>
struct npy_format_descriptor<anynet::bfloat16> {
  static constexpr auto name = const_name("numpy.uint16");
  static pybind11::dtype dtype() { return pybind11::dtype("uint16"); }
};
}  // namespace pybind11::detail

namespace anynet::bindings {

template <class T>
using Array = pybind11::array_t<T>;

/// A contiguous array; others are copied.
template <class T>
using Contiguous = pybind11::array_t<T, pybind11::array::c_style>;

/// scale, shift [C] as an epilogue.
inline AffineRelu<float> affine_relu(const Contiguous<float>& scale, const Contiguous<float>& shift) {
  return {scale.data(), shift.data(), scale.size()};
}

/// A NumPy array as a kernel's view. The array's strides must be whole elements.
template <class T, int Rank = 4>
View<const T, Rank> view(const Array<T>& array) {
  if (array.ndim() != Rank) {
    throw std::invalid_argument("expected an array of " + std::to_string(Rank) + " dimensions, got " +
                                std::to_string(array.ndim()));
  }
  View<const T, Rank> v;
  v.data = array.data();
  for (int i = 0; i < Rank; ++i) {
    v.size[i] = array.shape(i);
    v.stride[i] = array.strides(i) / static_cast<int64_t>(sizeof(T));
  }
  return v;
}

/// An uninitialized contiguous array of the shape of `like`.
template <class T>
Array<T> empty_like(const Array<T>& like) {
  return Array<T>(std::vector<pybind11::ssize_t>(like.shape(), like.shape() + like.ndim()));
}

/// What a file adds to the module: `const Binding binding(bind);` in an unnamed namespace at its end.
class Binding {
 public:
  using Function = void (*)(pybind11::module_&);
  explicit Binding(Function bind) { all().push_back(bind); }
  static std::vector<Function>& all() {
    static std::vector<Function> functions;
    return functions;
  }
};

/// Calls bind(m, T{}) for every element type.
template <class Bind>
void for_each_type(pybind11::module_& m, const Bind& bind) {
  bind(m, float{});
  bind(m, double{});
  bind(m, float16{});
  bind(m, bfloat16{});
}

}  // namespace anynet::bindings
