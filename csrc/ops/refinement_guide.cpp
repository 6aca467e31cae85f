#include "../kernels/refinement_guide/refinement_guide.h"

#include "backend.h"

namespace anynet::ops {
namespace {

Tensor refinement_guide(const Tensor& left, const Tensor& right, const Tensor& disparity, const Tensor& mean,
                        const Tensor& std, int64_t factor, int64_t block) {
  const char* op = "refinement_guide";
  check_contiguous(op, "disparity", disparity, 4);
  ANYNET_CHECK(disparity.size(0) == 1 && disparity.size(1) == 1, op, ": expected disparity of shape [1, 1, H, W], got ",
               shape(disparity));
  const int64_t height = disparity.size(2), width = disparity.size(3);
  check_size(op, height, width);
  check_images(op, left, right, disparity);
  check_vector(op, "mean", mean, 3, disparity);
  check_vector(op, "std", std, 3, disparity);
  ANYNET_CHECK(factor == 1 || factor == 2 || factor == 4, op, ": expected factor 1, 2 or 4, got ", factor);
  ANYNET_CHECK(block == 1 || (block == 2 && factor > 1), op, ": expected block 1 or 2, at most the factor, got ",
               block);
  Tensor out = new_tensor(disparity, {1, 3 * block * block + 4, height, width});
  const RefinementGuide<float> args{{data<uint8_t>(left), data<uint8_t>(right)},
                                    left.size(0),
                                    left.size(1),
                                    factor,
                                    block,
                                    height,
                                    width,
                                    data<float>(disparity),
                                    data<float>(mean),
                                    data<float>(std),
                                    data<float>(out)};
  ANYNET_RUN(refinement_guide, args, disparity);
  return out;
}

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(m,
                "refinement_guide(Tensor left, Tensor right, Tensor disparity, Tensor mean, Tensor std, int factor, "
                "int block) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("refinement_guide", TORCH_BOX(&refinement_guide));
}

}  // namespace anynet::ops
