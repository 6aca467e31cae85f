#include "../kernels/warp/warp.h"

#include <tuple>

#include "backend.h"

namespace anynet::ops {

namespace {

void check_warp(const Tensor& image, const Tensor& disparity) {
  ANYNET_CHECK(image.dim() == 4, "warp: expected image of shape [N, C, H, W], got ", shape(image));
  check_tensor("warp", "disparity", disparity, {image.size(0), 1, image.size(2), image.size(3)}, image);
  ANYNET_CHECK(image.size(3) < max_size, "warp: expected less than 2^30 columns, got image ", shape(image));
}

void check_warp_backward(const Tensor& grad, const Tensor& image, const Tensor& disparity) {
  check_warp(image, disparity);
  check_tensor("warp_backward", "grad", grad, {image.size(0), image.size(1), image.size(2), image.size(3)}, image);
}

}  // namespace

Tensor warp(const Tensor& image, const Tensor& disparity) {
  check_warp(image, disparity);
  Tensor out = new_like(image);
  dispatch(image.scalar_type(), "warp", [&](auto t) {
    using T = decltype(t);
    const Warp<T> args{view<T>(image), view<T>(disparity), data<T>(out)};
    ANYNET_RUN(warp, args, image);
  });
  return out;
}

std::tuple<Tensor, Tensor> warp_backward(const Tensor& grad, const Tensor& image, const Tensor& disparity) {
  check_warp_backward(grad, image, disparity);
  Tensor grad_image = new_like(image), grad_disparity = new_like(disparity);
  dispatch(image.scalar_type(), "warp_backward", [&](auto t) {
    using T = decltype(t);
    const WarpBackward<T> args{view<T>(grad), view<T>(image), view<T>(disparity), data<T>(grad_image),
                               data<T>(grad_disparity)};
    ANYNET_RUN(warp_backward, args, image);
  });
  return {grad_image, grad_disparity};
}

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(m, "warp(Tensor image, Tensor disparity) -> Tensor");
  ANYNET_SCHEMA(m, "warp_backward(Tensor grad, Tensor image, Tensor disparity) -> (Tensor, Tensor)");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("warp", TORCH_BOX(&warp));
  m.impl("warp_backward", TORCH_BOX(&warp_backward));
}

}  // namespace anynet::ops
