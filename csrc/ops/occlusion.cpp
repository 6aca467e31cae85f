#include "../kernels/occlusion/occlusion.h"

#include <cmath>

#include "backend.h"

namespace anynet::ops {
namespace {

Tensor fill_occlusions(const Tensor& disparity, double pixel) {
  check_contiguous("fill_occlusions", "disparity", disparity, 4);
  const float width_of_pixel = static_cast<float>(pixel);  // may become 0 or infinite
  ANYNET_CHECK(width_of_pixel > 0 && std::isfinite(width_of_pixel),
               "fill_occlusions: expected as float32 a finite pixel above 0, got ", pixel);
  Tensor out = new_like(disparity);
  if (out.numel() == 0) return out;
  const int64_t width = disparity.size(3);
  const FillOcclusions<float> args{disparity.numel() / width, width, data<float>(disparity), width_of_pixel,
                                   data<float>(out)};
  ANYNET_RUN(fill_occlusions, args, disparity);
  return out;
}

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(m, "fill_occlusions(Tensor disparity, float pixel) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("fill_occlusions", TORCH_BOX(&fill_occlusions));
}

}  // namespace anynet::ops
