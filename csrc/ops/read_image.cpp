#include "../kernels/read_image/read_image.h"

#include "backend.h"

namespace anynet::ops {
namespace {

Tensor read_image(const Tensor& image, const Tensor& mean, const Tensor& std, int64_t factor, int64_t block,
                  int64_t height, int64_t width) {
  check_image("read_image", image);
  check_device("read_image", "image", image, mean);
  check_vector("read_image", "mean", mean, 3, mean);
  check_vector("read_image", "std", std, 3, mean);
  ANYNET_CHECK(factor == 1 || factor == 2 || factor == 4, "read_image: expected factor 1, 2 or 4, got ", factor);
  ANYNET_CHECK(block == 1 || block == 2, "read_image: expected block 1 or 2, got ", block);
  check_size("read_image", height, width);
  Tensor out = new_tensor(mean, {1, 3 * block * block, height, width});
  const ReadImage<float> args{data<uint8_t>(image), image.size(0),    image.size(1),   factor, block, height, width,
                              data<float>(mean),    data<float>(std), data<float>(out)};
  ANYNET_RUN(read_image, args, mean);
  return out;
}

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(
      m,
      "read_image(Tensor image, Tensor mean, Tensor std, int factor, int block, SymInt height, SymInt width) -> "
      "Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) { m.impl("read_image", TORCH_BOX(&read_image)); }

}  // namespace anynet::ops
