#include "../kernels/stem/stem.h"

#include "backend.h"

namespace anynet::ops {

Tensor stem(const Tensor& left, const Tensor& right, const Tensor& mean, const Tensor& weight_first,
            const Tensor& bias_first, const Tensor& weight_second, const Tensor& scale, const Tensor& shift,
            int64_t input_scale, int64_t multiple) {
  check_images("stem", left, right, mean);
  ANYNET_CHECK(input_scale == 1 || input_scale == 2, "stem: expected input_scale 1 or 2, got ", input_scale);
  ANYNET_CHECK(multiple > 0 && multiple % 4 == 0 && multiple <= 65536,
               "stem: expected multiple to be a multiple of 4, at most 65536, got ", multiple);
  const int64_t channels = bias_first.numel();
  check_contiguous("stem", "mean", mean, 1);
  check_contiguous("stem", "weight_first", weight_first, 4);
  check_contiguous("stem", "weight_second", weight_second, 4);
  check_tensor("stem", "mean", mean, {3}, mean);
  check_tensor("stem", "weight_first", weight_first, {channels, 3, 3, 3}, mean);
  check_vector("stem", "bias_first", bias_first, channels, mean);
  check_tensor("stem", "weight_second", weight_second, {channels, channels, 3, 3}, mean);
  const AffineRelu<float> epilogue = affine_relu("stem", scale, shift, channels, mean);
  const auto padded = [&](int64_t size) { return (size + multiple - 1) / multiple * multiple; };
  const int64_t height = padded(input_scale * left.size(0)), width = padded(input_scale * left.size(1));
  Tensor out = new_tensor(mean, {2, channels, height / 4, width / 4});
  const Stem<float> args{{data<uint8_t>(left), data<uint8_t>(right)},
                         left.size(0),
                         left.size(1),
                         input_scale,
                         height,
                         width,
                         channels,
                         data<float>(mean),
                         data<float>(weight_first),
                         data<float>(bias_first),
                         data<float>(weight_second),
                         epilogue,
                         data<float>(out)};
  ANYNET_RUN(stem, args, mean);
  return out;
}

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(
      m,
      "stem(Tensor left, Tensor right, Tensor mean, Tensor weight_first, Tensor bias_first, Tensor weight_second, "
      "Tensor scale, Tensor shift, int input_scale=1, int multiple=4) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) { m.impl("stem", TORCH_BOX(&stem)); }

}  // namespace anynet::ops
