#include "../kernels/max_pool/max_pool.h"

#include "backend.h"

namespace anynet::ops {
namespace {

Tensor max_pool(const Tensor& input, const Tensor& scale, const Tensor& shift) {
  check_contiguous("max_pool", "input", input, 4);
  const AffineRelu<float> epilogue = affine_relu("max_pool", scale, shift, input.size(1), input);
  Tensor out = new_tensor(input, {input.size(0), input.size(1), input.size(2) / 2, input.size(3) / 2});
  const MaxPool<float> args{input.size(0),      input.size(1), input.size(2),   input.size(3),
                            data<float>(input), epilogue,      data<float>(out)};
  ANYNET_RUN(max_pool, args, input);
  return out;
}

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(m, "max_pool(Tensor input, Tensor scale, Tensor shift) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) { m.impl("max_pool", TORCH_BOX(&max_pool)); }

}  // namespace anynet::ops
