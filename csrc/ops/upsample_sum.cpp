#include "../kernels/upsample_sum/upsample_sum.h"

#include <vector>

#include "tensor.h"

namespace anynet::ops {

Tensor upsample_sum(const std::vector<Tensor>& maps, const std::vector<int64_t>& ratios, double gain, int64_t height,
                    int64_t width) {
  ANYNET_CHECK(!maps.empty() && maps.size() <= max_maps && maps.size() == ratios.size(),
               "upsample_sum: expected 1 to ", max_maps, " maps and as many ratios, got ", maps.size(), " and ",
               ratios.size());
  ANYNET_CHECK(height > 0 && width > 0, "upsample_sum: expected a size of at least one pixel, got ", height, " x ",
               width);
  UpsampleSum<float> args{};
  args.count = static_cast<int>(maps.size());
  for (int i = 0; i < args.count; ++i) {
    const Tensor& map = maps[i];
    ANYNET_CHECK(map.dim() == 2 && map.scalar_type() == ScalarType::Float && map.is_contiguous(),
                 "upsample_sum: expected contiguous float32 maps of shape [H, W], got ", shape(map));
    ANYNET_CHECK(ratios[i] > 0 && map.size(0) * ratios[i] >= height && map.size(1) * ratios[i] >= width,
                 "upsample_sum: expected maps that cover ", height, " x ", width, ", got ", shape(map), " times ",
                 ratios[i]);
    args.map[i] = data<float>(map);
    args.height[i] = map.size(0);
    args.width[i] = map.size(1);
    args.ratio[i] = ratios[i];
  }
  Tensor out = empty_like(maps[0], {height, width});
  args.gain = static_cast<float>(gain);
  args.out_height = height;
  args.out_width = width;
  args.out = data<float>(out);
  anynet::upsample_sum(chosen_isa(), args, num_threads());
  return out;
}

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  m.def("upsample_sum(Tensor[] maps, int[] ratios, float gain, SymInt height, SymInt width) -> Tensor",
        {at::Tag::pt2_compliant_tag});
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) { m.impl("upsample_sum", TORCH_BOX(&upsample_sum)); }

}  // namespace anynet::ops
