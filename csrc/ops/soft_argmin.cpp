#include "../kernels/soft_argmin/soft_argmin.h"

#include "backend.h"

namespace anynet::ops {

namespace {

void check_soft_argmin(const Tensor& cost) {
  ANYNET_CHECK(cost.dim() == 4 && cost.size(1) > 0,
               "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got ", shape(cost));
}

void check_soft_argmin_backward(const Tensor& grad, const Tensor& cost) {
  check_soft_argmin(cost);
  check_tensor("soft_argmin_backward", "grad", grad, {cost.size(0), 1, cost.size(2), cost.size(3)}, cost);
}

}  // namespace

Tensor soft_argmin(const Tensor& cost, int64_t first) {
  check_soft_argmin(cost);
  Tensor out = new_tensor(cost, {cost.size(0), 1, cost.size(2), cost.size(3)});
  dispatch(cost.scalar_type(), "soft_argmin", [&](auto t) {
    using T = decltype(t);
    const SoftArgmin<T> args{view<T>(cost), first, data<T>(out)};
    ANYNET_RUN(soft_argmin, args, cost);
  });
  return out;
}

Tensor soft_argmin_backward(const Tensor& grad, const Tensor& cost, int64_t first) {
  check_soft_argmin_backward(grad, cost);
  Tensor grad_cost = new_like(cost);
  dispatch(cost.scalar_type(), "soft_argmin_backward", [&](auto t) {
    using T = decltype(t);
    const SoftArgminBackward<T> args{view<T>(grad), view<T>(cost), first, data<T>(grad_cost)};
    ANYNET_RUN(soft_argmin_backward, args, cost);
  });
  return grad_cost;
}

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(m, "soft_argmin(Tensor cost, int first=0) -> Tensor");
  ANYNET_SCHEMA(m, "soft_argmin_backward(Tensor grad, Tensor cost, int first) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("soft_argmin", TORCH_BOX(&soft_argmin));
  m.impl("soft_argmin_backward", TORCH_BOX(&soft_argmin_backward));
}

}  // namespace anynet::ops
