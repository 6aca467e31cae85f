#include "../kernels/occlusion/occlusion.h"

#include <cmath>

#include "tensor.h"

namespace anynet::ops {
namespace {

Tensor fill_occlusions(const Tensor& disparity, double pixel) {
  check_contiguous("fill_occlusions", "disparity", disparity, 4);
  ANYNET_CHECK(pixel > 0 && std::isfinite(pixel), "fill_occlusions: expected a finite pixel above 0, got ", pixel);
  Tensor out = contiguous_like(disparity);
  if (out.numel() == 0) return out;
  const int64_t width = disparity.size(3);
  const FillOcclusions<float> args{disparity.numel() / width, width, data<float>(disparity), static_cast<float>(pixel),
                                   data<float>(out)};
  anynet::fill_occlusions(chosen_isa(), args, num_threads());
  return out;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  ANYNET_SCHEMA(m, "fill_occlusions(Tensor disparity, float pixel) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) { m.impl("fill_occlusions", TORCH_BOX(&fill_occlusions)); }

}  // namespace anynet::ops
