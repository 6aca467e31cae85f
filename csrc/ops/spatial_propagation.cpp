#include "spatial_propagation.h"

#include <tuple>

#include "../kernels/spatial_propagation/spatial_propagation.h"
#include "backend.h"

namespace anynet::ops {

Tensor spatial_propagation(const Tensor& input, const Tensor& gates, int64_t direction) {
  check_spatial_propagation("spatial_propagation", input, gates, direction);
  Tensor out = contiguous_like(input);
  dispatch(input.scalar_type(), "spatial_propagation", [&](auto t) {
    using T = decltype(t);
    const SpatialPropagation<T> args{view<T>(input), view<T, 5>(gates), static_cast<int>(direction), data<T>(out)};
    ANYNET_RUN(spatial_propagation, args, input);
  });
  return out;
}

std::tuple<Tensor, Tensor> spatial_propagation_backward(const Tensor& grad, const Tensor& input, const Tensor& gates,
                                                        const Tensor& out, int64_t direction) {
  check_spatial_propagation_backward(grad, input, gates, out, direction);
  Tensor grad_input = contiguous_like(input), grad_gates = contiguous_like(gates);
  dispatch(input.scalar_type(), "spatial_propagation_backward", [&](auto t) {
    using T = decltype(t);
    const SpatialPropagationBackward<T> args{
        view<T>(grad),       view<T>(input),     view<T, 5>(gates), view<T>(out), static_cast<int>(direction),
        data<T>(grad_input), data<T>(grad_gates)};
    ANYNET_RUN(spatial_propagation_backward, args, input);
  });
  return {grad_input, grad_gates};
}

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  m.def("spatial_propagation(Tensor input, Tensor gates, int direction) -> Tensor");
  m.def(
      "spatial_propagation_backward(Tensor grad, Tensor input, Tensor gates, Tensor out, int direction) -> "
      "(Tensor, Tensor)");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("spatial_propagation", TORCH_BOX(&spatial_propagation));
  m.impl("spatial_propagation_backward", TORCH_BOX(&spatial_propagation_backward));
}

}  // namespace anynet::ops
