#include "../kernels/max_pool/max_pool.h"

#include "tensor.h"

namespace anynet::ops {
namespace {

Tensor max_pool(const Tensor& input, const Tensor& scale, const Tensor& shift) {
  check_contiguous("max_pool", "input", input, 4);
  const AffineRelu<float> epilogue = affine_relu("max_pool", scale, shift, input.size(1), input);
  Tensor out = empty_like(input, {input.size(0), input.size(1), input.size(2) / 2, input.size(3) / 2});
  const MaxPool<float> args{input.size(0),      input.size(1), input.size(2),   input.size(3),
                            data<float>(input), epilogue,      data<float>(out)};
  anynet::max_pool(chosen_isa(), args, num_threads());
  return out;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  ANYNET_SCHEMA(m, "max_pool(Tensor input, Tensor scale, Tensor shift) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) { m.impl("max_pool", TORCH_BOX(&max_pool)); }

}  // namespace anynet::ops
