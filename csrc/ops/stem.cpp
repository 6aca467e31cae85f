#include "../kernels/stem/stem.h"

#include "tensor.h"

namespace anynet::ops {

Tensor stem(const Tensor& left, const Tensor& right, const Tensor& mean, const Tensor& weight_first,
            const Tensor& bias_first, const Tensor& weight_second, const Tensor& scale, const Tensor& shift,
            int64_t multiple) {
  for (const Tensor* image : {&left, &right}) {
    ANYNET_CHECK(image->dim() == 3 && image->size(0) > 0 && image->size(1) > 0 && image->size(2) == 3 &&
                     image->scalar_type() == ScalarType::Byte && image->is_contiguous(),
                 "stem: expected contiguous uint8 images of shape [H, W, 3], got ", shape(*image));
    ANYNET_CHECK(image->size(0) == left.size(0) && image->size(1) == left.size(1),
                 "stem: expected images of one size, got ", shape(left), " and ", shape(right));
  }
  ANYNET_CHECK(multiple > 0 && multiple % 4 == 0, "stem: expected a multiple of 4, got ", multiple);
  ANYNET_CHECK(mean.scalar_type() == ScalarType::Float, "stem: expected float32 weights");
  const int64_t channels = bias_first.size(0);
  check_tensor("stem", "mean", mean, {3}, mean);
  check_tensor("stem", "weight_first", weight_first, {channels, 3, 3, 3}, mean);
  check_tensor("stem", "bias_first", bias_first, {channels}, mean);
  check_tensor("stem", "weight_second", weight_second, {channels, channels, 3, 3}, mean);
  check_tensor("stem", "scale", scale, {channels}, mean);
  check_tensor("stem", "shift", shift, {channels}, mean);
  for (const Tensor* weight : {&mean, &weight_first, &bias_first, &weight_second, &scale, &shift}) {
    ANYNET_CHECK(weight->is_contiguous(), "stem: expected contiguous weights");
  }
  const auto padded = [&](int64_t size) { return (size + multiple - 1) / multiple * multiple; };
  const int64_t height = padded(left.size(0)), width = padded(left.size(1));
  Tensor out = empty_like(mean, {2, channels, height / 4, width / 4});
  const Stem<float> args{{data<uint8_t>(left), data<uint8_t>(right)},
                         left.size(0),
                         left.size(1),
                         height,
                         width,
                         channels,
                         data<float>(mean),
                         data<float>(weight_first),
                         data<float>(bias_first),
                         data<float>(weight_second),
                         data<float>(scale),
                         data<float>(shift),
                         data<float>(out)};
  anynet::stem(chosen_isa(), args, num_threads());
  return out;
}

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  m.def(
      "stem(Tensor left, Tensor right, Tensor mean, Tensor weight_first, Tensor bias_first, Tensor weight_second, "
      "Tensor scale, Tensor shift, int multiple) -> Tensor",
      {at::Tag::pt2_compliant_tag});
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) { m.impl("stem", TORCH_BOX(&stem)); }

}  // namespace anynet::ops
