#include "warp.h"

#include <tuple>

#include "../kernels/warp/warp.h"

namespace anynet::ops {

Tensor warp(const Tensor& image, const Tensor& disparity) {
  check_warp(image, disparity);
  Tensor out = contiguous_like(image);
  dispatch(image.scalar_type(), "warp", [&](auto t) {
    using T = decltype(t);
    const Warp<T> args{view<T>(image), view<T>(disparity), data<T>(out)};
    anynet::warp(chosen_isa(), args, num_threads());
  });
  return out;
}

std::tuple<Tensor, Tensor> warp_backward(const Tensor& grad, const Tensor& image, const Tensor& disparity) {
  check_warp_backward(grad, image, disparity);
  Tensor grad_image = contiguous_like(image), grad_disparity = contiguous_like(disparity);
  dispatch(image.scalar_type(), "warp_backward", [&](auto t) {
    using T = decltype(t);
    const WarpBackward<T> args{view<T>(grad), view<T>(image), view<T>(disparity), data<T>(grad_image),
                               data<T>(grad_disparity)};
    anynet::warp_backward(chosen_isa(), args, num_threads());
  });
  return {grad_image, grad_disparity};
}

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  m.def("warp(Tensor image, Tensor disparity) -> Tensor", {at::Tag::pt2_compliant_tag});
  m.def("warp_backward(Tensor grad, Tensor image, Tensor disparity) -> (Tensor, Tensor)", {at::Tag::pt2_compliant_tag});
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) {
  m.impl("warp", TORCH_BOX(&warp));
  m.impl("warp_backward", TORCH_BOX(&warp_backward));
}

}  // namespace anynet::ops
