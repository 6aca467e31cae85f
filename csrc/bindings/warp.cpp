#include "../kernels/warp/warp.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_warp(pybind11::module_& module) {
  for_each_type(module, [](pybind11::module_& m, auto type) {
    using T = decltype(type);
    m.def("warp", [](Isa isa, const Array<T>& image, const Array<T>& disparity, int threads) {
      Array<T> out = empty_like(image);
      const Warp<T> args{view<T>(image), view<T>(disparity), out.mutable_data()};
      anynet::warp(isa, args, threads);
      return out;
    });
    m.def("warp_backward",
          [](Isa isa, const Array<T>& grad, const Array<T>& image, const Array<T>& disparity, int threads) {
            Array<T> grad_image = empty_like(image), grad_disparity = empty_like(disparity);
            const WarpBackward<T> args{view<T>(grad), view<T>(image), view<T>(disparity), grad_image.mutable_data(),
                                       grad_disparity.mutable_data()};
            anynet::warp_backward(isa, args, threads);
            return pybind11::make_tuple(grad_image, grad_disparity);
          });
  });
}

const Binding binding(bind_warp);

}  // namespace
}  // namespace anynet::bindings
