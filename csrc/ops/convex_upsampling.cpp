#include "../kernels/convex_upsampling/convex_upsampling.h"

#include "backend.h"

namespace anynet::ops {
namespace {

Tensor convex_upsampling(const Tensor& input, const Tensor& logits) {
  check_contiguous("convex_upsampling", "input", input, 4);
  check_contiguous("convex_upsampling", "logits", logits, 4);
  const int64_t n = input.size(0), height = input.size(2), width = input.size(3);
  check_tensor("convex_upsampling", "input", input, {n, 1, height, width}, input);
  check_tensor("convex_upsampling", "logits", logits, {n, 32, height, width}, input);
  Tensor out = new_tensor(input, {n, 1, 2 * height, 2 * width});
  if (out.numel() == 0) return out;
  const ConvexUpsampling<float> args{n, height, width, data<float>(input), data<float>(logits), data<float>(out)};
  ANYNET_RUN(convex_upsampling, args, input);
  return out;
}

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(m, "convex_upsampling(Tensor input, Tensor logits) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("convex_upsampling", TORCH_BOX(&convex_upsampling));
}

}  // namespace anynet::ops
