#include "cost_volume.h"

#include <tuple>

#include "../kernels/cost_volume/cost_volume.h"
#include "backend.h"

namespace anynet::ops {

namespace {

template <class T>
View4<const T> view(const std::optional<Tensor>& t) {
  return t.has_value() ? ops::view<T>(*t) : View4<const T>{};
}

}  // namespace

Tensor cost_volume(const Tensor& left, const Tensor& right, const std::optional<Tensor>& disparity, int64_t first,
                   int64_t last) {
  check_cost_volume("cost_volume", left, right, disparity, first, last);
  const int64_t count = last - first + 1;
  Tensor out = empty_like(left, {left.size(0), count, left.size(2), left.size(3)});
  dispatch(left.scalar_type(), "cost_volume", [&](auto t) {
    using T = decltype(t);
    const CostVolume<T> args{ops::view<T>(left), ops::view<T>(right), view<T>(disparity), first, count, data<T>(out)};
    ANYNET_RUN(cost_volume, args, left);
  });
  return out;
}

std::tuple<Tensor, Tensor, Tensor> cost_volume_backward(const Tensor& grad, const Tensor& left, const Tensor& right,
                                                        const std::optional<Tensor>& disparity, int64_t first,
                                                        int64_t last) {
  check_cost_volume_backward(grad, left, right, disparity, first, last);
  Tensor grad_left = contiguous_like(left), grad_right = contiguous_like(right);
  Tensor grad_disparity = disparity.has_value() ? contiguous_like(*disparity) : empty_like(left, {0});
  dispatch(left.scalar_type(), "cost_volume_backward", [&](auto t) {
    using T = decltype(t);
    const CostVolumeBackward<T> args{ops::view<T>(grad),
                                     ops::view<T>(left),
                                     ops::view<T>(right),
                                     view<T>(disparity),
                                     first,
                                     last - first + 1,
                                     data<T>(grad_left),
                                     data<T>(grad_right),
                                     disparity.has_value() ? data<T>(grad_disparity) : nullptr};
    ANYNET_RUN(cost_volume_backward, args, left);
  });
  return {grad_left, grad_right, grad_disparity};
}

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  m.def("cost_volume(Tensor left, Tensor right, Tensor? disparity, int first, int last) -> Tensor");
  // Without disparity the third result is empty.
  m.def(
      "cost_volume_backward(Tensor grad, Tensor left, Tensor right, Tensor? disparity, int first, int last) -> "
      "(Tensor, Tensor, Tensor)");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("cost_volume", TORCH_BOX(&cost_volume));
  m.impl("cost_volume_backward", TORCH_BOX(&cost_volume_backward));
}

}  // namespace anynet::ops
