#include "../kernels/resize/resize.h"

#include "tensor.h"

namespace anynet::ops {

namespace {

void check_resize(const Tensor& input, int64_t height, int64_t width, const std::optional<Tensor>& add) {
  ANYNET_CHECK(input.dim() == 4 && input.size(2) > 0 && input.size(3) > 0,
               "resize: expected input of shape [N, C, H, W] with H, W >= 1, got ", shape(input));
  check_size("resize", height, width);
  check_size("resize", input.size(2), input.size(3));
  if (add.has_value()) check_tensor("resize", "add", *add, {input.size(0), input.size(1), height, width}, input);
}

void check_resize_backward(const Tensor& grad, int64_t height, int64_t width) {
  ANYNET_CHECK(grad.dim() == 4 && grad.size(2) > 0 && grad.size(3) > 0,
               "resize_backward: expected grad of shape [N, C, H, W] with H, W >= 1, got ", shape(grad));
  check_size("resize_backward", height, width);
  check_size("resize_backward", grad.size(2), grad.size(3));
}

}  // namespace

Tensor resize(const Tensor& input, int64_t height, int64_t width, double scale, const std::optional<Tensor>& add,
              bool align_corners) {
  check_resize(input, height, width, add);
  Tensor out = new_tensor(input, {input.size(0), input.size(1), height, width});
  if (out.numel() == 0) return out;
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
  Tensor grad_input = new_tensor(grad, {grad.size(0), grad.size(1), height, width});
  if (grad_input.numel() == 0) return grad_input;
  dispatch(grad.scalar_type(), "resize_backward", [&](auto t) {
    using T = decltype(t);
    const ResizeBackward<T> args{view<T>(grad), height, width, scale, align_corners, data<T>(grad_input)};
    anynet::resize_backward(chosen_isa(), args, num_threads());
  });
  return grad_input;
}

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  ANYNET_SCHEMA(
      m,
      "resize(Tensor input, SymInt height, SymInt width, float scale=1.0, Tensor? add=None, bool align_corners=False) "
      "-> Tensor");
  ANYNET_SCHEMA(m,
                "resize_backward(Tensor grad, SymInt height, SymInt width, float scale, bool align_corners) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) {
  m.impl("resize", TORCH_BOX(&resize));
  m.impl("resize_backward", TORCH_BOX(&resize_backward));
}

}  // namespace anynet::ops
