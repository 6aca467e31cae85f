#include "resize.h"

#include "../kernels/resize/resize.h"

namespace anynet::ops {

Tensor resize(const Tensor& input, int64_t height, int64_t width, double scale, const std::optional<Tensor>& add,
              bool align_corners) {
  check_resize(input, height, width, add);
  Tensor out = empty_like(input, {input.size(0), input.size(1), height, width});
  dispatch(input.scalar_type(), "resize", [&](auto t) {
    using T = decltype(t);
    const Resize<T> args{
        view<T>(input), add.has_value() ? view<T>(*add) : View4<const T>{}, height, width, scale, align_corners,
        data<T>(out)};
    anynet::resize(chosen_isa(), args, num_threads());
  });
  return out;
}

Tensor resize_backward(const Tensor& grad, int64_t height, int64_t width, double scale, bool align_corners) {
  check_resize_backward(grad, height, width);
  Tensor grad_input = empty_like(grad, {grad.size(0), grad.size(1), height, width});
  dispatch(grad.scalar_type(), "resize_backward", [&](auto t) {
    using T = decltype(t);
    const ResizeBackward<T> args{view<T>(grad), height, width, scale, align_corners, data<T>(grad_input)};
    anynet::resize_backward(chosen_isa(), args, num_threads());
  });
  return grad_input;
}

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  m.def("resize(Tensor input, SymInt height, SymInt width, float scale, Tensor? add, bool align_corners) -> Tensor");
  m.def("resize_backward(Tensor grad, SymInt height, SymInt width, float scale, bool align_corners) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) {
  m.impl("resize", TORCH_BOX(&resize));
  m.impl("resize_backward", TORCH_BOX(&resize_backward));
}

}  // namespace anynet::ops
