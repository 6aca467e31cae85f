#include "../kernels/spatial_propagation/spatial_propagation.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_spatial_propagation(pybind11::module_& module) {
  for_each_type(module, [](pybind11::module_& m, auto type) {
    using T = decltype(type);
    m.def("spatial_propagation", [](Isa isa, const Array<T>& input, const Array<T>& gates, int direction, int threads) {
      Array<T> out = empty_like(input);
      const SpatialPropagation<T> args{view<T>(input), view<T, 5>(gates), direction, out.mutable_data()};
      anynet::spatial_propagation(isa, args, threads);
      return out;
    });
    m.def("spatial_propagation_backward", [](Isa isa, const Array<T>& grad, const Array<T>& input,
                                             const Array<T>& gates, const Array<T>& out, int direction, int threads) {
      Array<T> grad_input = empty_like(input), grad_gates = empty_like(gates);
      const SpatialPropagationBackward<T> args{view<T>(grad),
                                               view<T>(input),
                                               view<T, 5>(gates),
                                               view<T>(out),
                                               direction,
                                               grad_input.mutable_data(),
                                               grad_gates.mutable_data()};
      anynet::spatial_propagation_backward(isa, args, threads);
      return pybind11::make_tuple(grad_input, grad_gates);
    });
  });
  module.def("normalized_propagation",
             [](Isa isa, const Contiguous<float>& input, const Contiguous<float>& gates, int direction, int threads) {
               Contiguous<float> out = empty_like<float>(input);
               const SpatialPropagation<float> args{view<float>(input), view<float, 5>(gates), direction,
                                                    out.mutable_data(), true};
               anynet::spatial_propagation(isa, args, threads);
               return out;
             });
}

const Binding binding(bind_spatial_propagation);

}  // namespace
}  // namespace anynet::bindings
