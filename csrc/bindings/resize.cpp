#include "../kernels/resize/resize.h"

#include <pybind11/stl.h>

#include <optional>

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_resize(pybind11::module_& m) {
  for_each_type(m, [](pybind11::module_& m, auto type) {
    using T = decltype(type);
    m.def("resize", [](Isa isa, const Array<T>& input, int64_t height, int64_t width, double scale,
                       const std::optional<Array<T>>& add, bool align_corners, int threads) {
      Array<T> out({input.shape(0), input.shape(1), height, width});
      const Resize<T> args{
          view<T>(input),    add ? view<T>(*add) : View4<const T>{}, height, width, scale, align_corners,
          out.mutable_data()};
      anynet::resize(isa, args, threads);
      return out;
    });
    m.def("resize_backward", [](Isa isa, const Array<T>& grad, int64_t height, int64_t width, double scale,
                                bool align_corners, int threads) {
      Array<T> grad_input({grad.shape(0), grad.shape(1), height, width});
      const ResizeBackward<T> args{view<T>(grad), height, width, scale, align_corners, grad_input.mutable_data()};
      anynet::resize_backward(isa, args, threads);
      return grad_input;
    });
  });
}

const Binding binding(bind_resize);

}  // namespace
}  // namespace anynet::bindings
