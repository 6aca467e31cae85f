#include "../kernels/upsample/upsample.h"

#include <vector>

#include "tensor.h"

namespace anynet::ops {
namespace {

Tensor upsample_sum(const std::vector<Tensor>& maps, const std::vector<int64_t>& ratios, double gain, int64_t height,
                    int64_t width) {
  ANYNET_CHECK(!maps.empty() && maps.size() <= max_maps && maps.size() == ratios.size(), "upsample_sum: expected 1 to ",
               max_maps, " maps and as many ratios, got ", maps.size(), " and ", ratios.size());
  check_size("upsample_sum", height, width);
  UpsampleSum<float> args{};
  args.count = static_cast<int>(maps.size());
  for (int i = 0; i < args.count; ++i) {
    const Tensor& map = maps[i];
    check_contiguous("upsample_sum", "maps", map, 2);
    ANYNET_CHECK(map.device() == maps[0].device(), "upsample_sum: expected all tensors on one device");
    ANYNET_CHECK(ratios[i] > 0 && (ratios[i] & (ratios[i] - 1)) == 0,
                 "upsample_sum: expected ratios that are a power of two, got ", ratios[i]);
    // Not by multiplying, which could overflow.
    ANYNET_CHECK((height - 1) / ratios[i] < map.size(0) && (width - 1) / ratios[i] < map.size(1),
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

Tensor upsample_concat(const Tensor& skip, const Tensor& coarse, const Tensor& scale, const Tensor& shift) {
  check_contiguous("upsample_concat", "skip", skip, 4);
  check_contiguous("upsample_concat", "coarse", coarse, 4);
  ANYNET_CHECK(skip.size(0) == coarse.size(0) && coarse.numel() > 0,
               "upsample_concat: expected coarse of skip's batch size, with at least one pixel, got ", shape(coarse));
  check_size("upsample_concat", coarse.size(2), coarse.size(3));
  const int64_t channels = skip.size(1) + coarse.size(1);
  const AffineRelu<float> epilogue = affine_relu("upsample_concat", scale, shift, channels, skip);
  Tensor out = empty_like(skip, {skip.size(0), channels, skip.size(2), skip.size(3)});
  if (out.numel() == 0) return out;
  const UpsampleConcat<float> args{skip.size(0),        skip.size(1),   coarse.size(1),  skip.size(2),
                                   skip.size(3),        coarse.size(2), coarse.size(3),  data<float>(skip),
                                   data<float>(coarse), epilogue,       data<float>(out)};
  anynet::upsample_concat(chosen_isa(), args, num_threads());
  return out;
}

Tensor upsample_add(const Tensor& input, const Tensor& coarse, const Tensor& scale, const Tensor& shift) {
  check_contiguous("upsample_add", "input", input, 5);
  check_contiguous("upsample_add", "coarse", coarse, 5);
  ANYNET_CHECK(input.size(0) == coarse.size(0) && input.size(1) == coarse.size(1) && coarse.numel() > 0,
               "upsample_add: expected coarse of input's batch size and channels, with at least one voxel, got ",
               shape(coarse));
  check_size("upsample_add", coarse.size(3), coarse.size(4));
  const AffineRelu<float> epilogue = affine_relu("upsample_add", scale, shift, input.size(1), input);
  Tensor out = contiguous_like(input);
  if (out.numel() == 0) return out;
  const UpsampleAdd<float> args{input.size(0),      input.size(1),       input.size(2),  input.size(3),
                                input.size(4),      coarse.size(2),      coarse.size(3), coarse.size(4),
                                data<float>(input), data<float>(coarse), epilogue,       data<float>(out)};
  anynet::upsample_add(chosen_isa(), args, num_threads());
  return out;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  ANYNET_SCHEMA(m, "upsample_sum(Tensor[] maps, int[] ratios, float gain, SymInt height, SymInt width) -> Tensor");
  ANYNET_SCHEMA(m, "upsample_concat(Tensor skip, Tensor coarse, Tensor scale, Tensor shift) -> Tensor");
  ANYNET_SCHEMA(m, "upsample_add(Tensor input, Tensor coarse, Tensor scale, Tensor shift) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) {
  m.impl("upsample_sum", TORCH_BOX(&upsample_sum));
  m.impl("upsample_concat", TORCH_BOX(&upsample_concat));
  m.impl("upsample_add", TORCH_BOX(&upsample_add));
}

}  // namespace anynet::ops
