#include "../kernels/cost_volume/cost_volume.h"

#include <tuple>

#include "backend.h"

namespace anynet::ops {
namespace {

void check_cost_volume(const char* op, const Tensor& left, const Tensor& right, const std::optional<Tensor>& disparity,
                       int64_t first, int64_t last) {
  ANYNET_CHECK(left.dim() == 4, op, ": expected left of shape [N, C, H, W], got ", shape(left));
  check_tensor(op, "right", right, {left.size(0), left.size(1), left.size(2), left.size(3)}, left);
  if (disparity.has_value()) {
    check_tensor(op, "disparity", *disparity, {left.size(0), 1, left.size(2), left.size(3)}, left);
  }
  ANYNET_CHECK(first <= last, op, ": expected first <= last, got first ", first, " and last ", last);
  int64_t span;
  ANYNET_CHECK(!__builtin_sub_overflow(last, first, &span) && span < max_size && left.size(3) < max_size - span, op,
               ": expected at most 2^30 columns and offsets, got first ", first, ", last ", last, " and left ",
               shape(left));
}

void check_cost_volume_backward(const Tensor& grad, const Tensor& left, const Tensor& right,
                                const std::optional<Tensor>& disparity, int64_t first, int64_t last) {
  check_cost_volume("cost_volume", left, right, disparity, first, last);
  check_tensor("cost_volume_backward", "grad", grad, {left.size(0), last - first + 1, left.size(2), left.size(3)},
               left);
}

template <class T>
View4<const T> view(const std::optional<Tensor>& t) {
  return t.has_value() ? ops::view<T>(*t) : View4<const T>{};
}

}  // namespace

Tensor cost_volume(const Tensor& left, const Tensor& right, const std::optional<Tensor>& disparity, int64_t first,
                   int64_t last) {
  check_cost_volume("cost_volume", left, right, disparity, first, last);
  const int64_t count = last - first + 1;
  Tensor out = new_tensor(left, {left.size(0), count, left.size(2), left.size(3)});
  dispatch(left.scalar_type(), "cost_volume", [&](auto t) {
    using T = decltype(t);
    const CostVolume<T> args{ops::view<T>(left), ops::view<T>(right), view<T>(disparity), first, count, data<T>(out)};
    ANYNET_RUN(cost_volume, args, left);
  });
  return out;
}

Tensor cost_volume_affine_relu(const Tensor& left, const Tensor& right, const std::optional<Tensor>& disparity,
                               int64_t first, int64_t last, const Tensor& scale, const Tensor& shift) {
  const char* op = "cost_volume_affine_relu";
  check_contiguous(op, "left", left, 4);
  check_cost_volume(op, left, right, disparity, first, last);
  const int64_t groups = scale.numel(), count = last - first + 1;
  const AffineRelu<float> epilogue = affine_relu(op, scale, shift, groups, left);
  ANYNET_CHECK(groups > 0 && left.size(0) % groups == 0, op, ": expected a scale for each of left's groups, got ",
               groups, " for left ", shape(left));
  Tensor out = new_tensor(left, {left.size(0), count, left.size(2), left.size(3)});
  const CostVolume<float> args{ops::view<float>(left),
                               ops::view<float>(right),
                               view<float>(disparity),
                               first,
                               count,
                               data<float>(out),
                               epilogue};
  ANYNET_RUN(cost_volume, args, left);
  return out;
}

std::tuple<Tensor, Tensor, Tensor> cost_volume_backward(const Tensor& grad, const Tensor& left, const Tensor& right,
                                                        const std::optional<Tensor>& disparity, int64_t first,
                                                        int64_t last) {
  check_cost_volume_backward(grad, left, right, disparity, first, last);
  Tensor grad_left = new_like(left), grad_right = new_like(right);
  Tensor grad_disparity = disparity.has_value() ? new_like(*disparity) : new_tensor(left, {0});
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
  ANYNET_SCHEMA(m, "cost_volume(Tensor left, Tensor right, Tensor? disparity=None, int first=0, int last=0) -> Tensor");
  // Without disparity the third result is empty.
  ANYNET_SCHEMA(
      m,
      "cost_volume_backward(Tensor grad, Tensor left, Tensor right, Tensor? disparity, int first, int last) -> "
      "(Tensor, Tensor, Tensor)");
  ANYNET_SCHEMA(
      m,
      "cost_volume_affine_relu(Tensor left, Tensor right, Tensor? disparity, int first, int last, Tensor scale, "
      "Tensor shift) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("cost_volume", TORCH_BOX(&cost_volume));
  m.impl("cost_volume_affine_relu", TORCH_BOX(&cost_volume_affine_relu));
  m.impl("cost_volume_backward", TORCH_BOX(&cost_volume_backward));
}

}  // namespace anynet::ops
