#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <stdexcept>

#include "../kernels/common/isa.h"
#include "../kernels/common/tensor.h"

namespace anynet::bindings {

/// A NumPy array as a kernel's view. The array's strides must be whole elements.
template <class T, int Rank = 4>
View<const T, Rank> view(const pybind11::array_t<T>& array) {
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

void bind_conv(pybind11::module_& m);
void bind_soft_argmin(pybind11::module_& m);

}  // namespace anynet::bindings
