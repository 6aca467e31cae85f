#include "../kernels/spatial_propagation/spatial_propagation.h"

#include <tuple>

#include "backend.h"

namespace anynet::ops {

namespace {

void check_spatial_propagation(const char* op, const Tensor& input, const Tensor& gates, int64_t direction) {
  ANYNET_CHECK(input.dim() == 4, op, ": expected input of shape [N, C, H, W], got ", shape(input));
  check_tensor(op, "gates", gates, {input.size(0), 3, input.size(1), input.size(2), input.size(3)}, input);
  ANYNET_CHECK(0 <= direction && direction <= 3, op, ": expected direction 0, 1, 2 or 3, got ", direction);
}

void check_spatial_propagation_backward(const Tensor& grad, const Tensor& input, const Tensor& gates, const Tensor& out,
                                        int64_t direction) {
  check_spatial_propagation("spatial_propagation_backward", input, gates, direction);
  for (const auto& [name, t] : {std::pair<const char*, const Tensor&>("grad", grad), {"out", out}}) {
    check_tensor("spatial_propagation_backward", name, t, {input.size(0), input.size(1), input.size(2), input.size(3)},
                 input);
  }
}

}  // namespace

Tensor spatial_propagation(const Tensor& input, const Tensor& gates, int64_t direction) {
  check_spatial_propagation("spatial_propagation", input, gates, direction);
  Tensor out = new_like(input);
  dispatch(input.scalar_type(), "spatial_propagation", [&](auto t) {
    using T = decltype(t);
    const SpatialPropagation<T> args{view<T>(input), view<T, 5>(gates), static_cast<int>(direction), data<T>(out)};
    ANYNET_RUN(spatial_propagation, args, input);
  });
  return out;
}

Tensor normalized_propagation(const Tensor& input, const Tensor& gates, int64_t direction) {
  check_contiguous("normalized_propagation", "input", input, 4);
  check_contiguous("normalized_propagation", "gates", gates, 5);
  check_spatial_propagation("normalized_propagation", input, gates, direction);
  Tensor out = new_like(input);
  const SpatialPropagation<float> args{view<float>(input), view<float, 5>(gates), static_cast<int>(direction),
                                       data<float>(out), true};
  ANYNET_RUN(spatial_propagation, args, input);
  return out;
}

std::tuple<Tensor, Tensor> spatial_propagation_backward(const Tensor& grad, const Tensor& input, const Tensor& gates,
                                                        const Tensor& out, int64_t direction) {
  check_spatial_propagation_backward(grad, input, gates, out, direction);
  Tensor grad_input = new_like(input), grad_gates = new_like(gates);
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
  ANYNET_SCHEMA(m, "spatial_propagation(Tensor input, Tensor gates, int direction) -> Tensor");
  ANYNET_SCHEMA(m,
                "spatial_propagation_backward(Tensor grad, Tensor input, Tensor gates, Tensor out, int direction) -> "
                "(Tensor, Tensor)");
  ANYNET_SCHEMA(m, "normalized_propagation(Tensor input, Tensor gates, int direction) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("spatial_propagation", TORCH_BOX(&spatial_propagation));
  m.impl("normalized_propagation", TORCH_BOX(&normalized_propagation));
  m.impl("spatial_propagation_backward", TORCH_BOX(&spatial_propagation_backward));
}

}  // namespace anynet::ops
