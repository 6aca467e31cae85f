#include "../kernels/inference/inference.h"

#include <vector>

#include "../kernels/cost_volume/cost_volume.h"
#include "../kernels/spatial_propagation/spatial_propagation.h"
#include "cost_volume.h"
#include "inference.h"
#include "spatial_propagation.h"

namespace anynet::ops {

Tensor upsample_sum(const std::vector<Tensor>& maps, const std::vector<int64_t>& ratios, double gain, int64_t height,
                    int64_t width) {
  ANYNET_CHECK(!maps.empty() && maps.size() <= max_maps && maps.size() == ratios.size(), "upsample_sum: expected 1 to ",
               max_maps, " maps and as many ratios, got ", maps.size(), " and ", ratios.size());
  ANYNET_CHECK(height > 0 && width > 0, "upsample_sum: expected a size of at least one pixel, got ", height, " x ",
               width);
  UpsampleSum<float> args{};
  args.count = static_cast<int>(maps.size());
  for (int i = 0; i < args.count; ++i) {
    const Tensor& map = maps[i];
    check_contiguous("upsample_sum", "maps", map, 2);
    ANYNET_CHECK(ratios[i] > 0 && (ratios[i] & (ratios[i] - 1)) == 0,
                 "upsample_sum: expected ratios that are a power of two, got ", ratios[i]);
    ANYNET_CHECK(map.size(0) * ratios[i] >= height && map.size(1) * ratios[i] >= width,
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
  const int64_t channels = skip.size(1) + coarse.size(1);
  check_affine("upsample_concat", scale, shift, channels, skip);
  Tensor out = empty_like(skip, {skip.size(0), channels, skip.size(2), skip.size(3)});
  const UpsampleConcat<float> args{skip.size(0),        skip.size(1),       coarse.size(1),     skip.size(2),
                                   skip.size(3),        coarse.size(2),     coarse.size(3),     data<float>(skip),
                                   data<float>(coarse), data<float>(scale), data<float>(shift), data<float>(out)};
  anynet::upsample_concat(chosen_isa(), args, num_threads());
  return out;
}

Tensor upsample_add(const Tensor& input, const Tensor& coarse, const Tensor& scale, const Tensor& shift) {
  check_contiguous("upsample_add", "input", input, 5);
  check_contiguous("upsample_add", "coarse", coarse, 5);
  ANYNET_CHECK(input.size(0) == coarse.size(0) && input.size(1) == coarse.size(1) && coarse.numel() > 0,
               "upsample_add: expected coarse of input's batch size and channels, with at least one voxel, got ",
               shape(coarse));
  check_affine("upsample_add", scale, shift, input.size(1), input);
  Tensor out = contiguous_like(input);
  const UpsampleAdd<float> args{input.size(0),      input.size(1),       input.size(2),      input.size(3),
                                input.size(4),      coarse.size(2),      coarse.size(3),     coarse.size(4),
                                data<float>(input), data<float>(coarse), data<float>(scale), data<float>(shift),
                                data<float>(out)};
  anynet::upsample_add(chosen_isa(), args, num_threads());
  return out;
}

Tensor cost_volume_affine_relu(const Tensor& left, const Tensor& right, const std::optional<Tensor>& disparity,
                               int64_t first, int64_t last, const Tensor& scale, const Tensor& shift) {
  check_contiguous("cost_volume_affine_relu", "left", left, 4);
  check_cost_volume("cost_volume_affine_relu", left, right, disparity, first, last);
  const int64_t groups = scale.numel();
  check_affine("cost_volume_affine_relu", scale, shift, groups, left);
  ANYNET_CHECK(groups > 0 && left.size(0) % groups == 0,
               "cost_volume_affine_relu: expected a scale for each of left's groups, got ", groups, " for left ",
               shape(left));
  Tensor out = empty_like(left, {left.size(0), last - first + 1, left.size(2), left.size(3)});
  const CostVolume<float> args{view<float>(left),
                               view<float>(right),
                               disparity.has_value() ? view<float>(*disparity) : View4<const float>{},
                               first,
                               last - first + 1,
                               data<float>(out),
                               data<float>(scale),
                               data<float>(shift),
                               groups};
  anynet::cost_volume(chosen_isa(), args, num_threads());
  return out;
}

Tensor max_pool(const Tensor& input, const Tensor& scale, const Tensor& shift) {
  check_contiguous("max_pool", "input", input, 4);
  check_affine("max_pool", scale, shift, input.size(1), input);
  Tensor out = empty_like(input, {input.size(0), input.size(1), input.size(2) / 2, input.size(3) / 2});
  const MaxPool<float> args{input.size(0),      input.size(1),      input.size(2),      input.size(3),
                            data<float>(input), data<float>(scale), data<float>(shift), data<float>(out)};
  anynet::max_pool(chosen_isa(), args, num_threads());
  return out;
}

Tensor normalized_propagation(const Tensor& input, const Tensor& gates, int64_t direction) {
  check_contiguous("normalized_propagation", "input", input, 4);
  check_contiguous("normalized_propagation", "gates", gates, 5);
  check_spatial_propagation("normalized_propagation", input, gates, direction);
  Tensor out = contiguous_like(input);
  const SpatialPropagation<float> args{view<float>(input), view<float, 5>(gates), static_cast<int>(direction),
                                       data<float>(out), true};
  anynet::spatial_propagation(chosen_isa(), args, num_threads());
  return out;
}

Tensor fill_occlusions(const Tensor& disparity, double pixel) {
  check_contiguous("fill_occlusions", "disparity", disparity, 4);
  ANYNET_CHECK(pixel > 0, "fill_occlusions: expected a pixel above 0, got ", pixel);
  Tensor out = contiguous_like(disparity);
  if (out.numel() == 0) return out;
  const int64_t width = disparity.size(3);
  const FillOcclusions<float> args{disparity.numel() / width, width, data<float>(disparity), static_cast<float>(pixel),
                                   data<float>(out)};
  anynet::fill_occlusions(chosen_isa(), args, num_threads());
  return out;
}

Tensor candidate_costs(const Tensor& features, const Tensor& disparity, int64_t groups, int64_t first, int64_t last,
                       int64_t radius) {
  check_contiguous("candidate_costs", "features", features, 4);
  check_contiguous("candidate_costs", "disparity", disparity, 4);
  const int64_t channels = features.size(1), height = features.size(2), width = features.size(3);
  check_tensor("candidate_costs", "features", features, {2, channels, height, width}, features);
  check_tensor("candidate_costs", "disparity", disparity, {1, 1, height, width}, features);
  ANYNET_CHECK(groups > 0 && channels % groups == 0, "candidate_costs: expected groups to divide the ", channels,
               " channels, got ", groups);
  ANYNET_CHECK(first <= last, "candidate_costs: expected first <= last, got first ", first, " and last ", last);
  ANYNET_CHECK(radius >= 0, "candidate_costs: expected a radius of 0 or more, got ", radius);
  const int64_t tested = last - first + 1, pixels = height * width;
  Tensor out = empty_like(features, {1, groups * (tested + 2) + channels + 2, height, width});
  if (out.numel() == 0) return out;
  const Isa isa = chosen_isa();
  const int threads = num_threads();
  float* near_costs = data<float>(out) + groups * tested * pixels;
  float* far_costs = near_costs + groups * pixels;
  float* copy = far_costs + groups * pixels;
  float* extremes = copy + channels * pixels;
  const WindowExtremes<float> window{height, width, radius, data<float>(disparity), extremes};
  anynet::window_extremes(isa, window, threads);

  const auto compare = [&](const float* around, int64_t from, int64_t count, float* costs) {
    View4<const float> left = view<float>(features), at = view<float>(disparity);
    left.size[0] = at.size[0] = groups;
    left.size[1] = channels / groups;
    left.stride[0] = left.size[1] * pixels;
    at.data = around;
    at.stride[0] = 0;
    View4<const float> right = left;
    right.data += channels * pixels;
    const CostVolume<float> args{left, right, at, from, count, costs};
    anynet::cost_volume(isa, args, threads);
  };
  compare(data<float>(disparity), first, tested, data<float>(out));
  compare(extremes, 0, 1, near_costs);
  compare(extremes + pixels, 0, 1, far_costs);
  const CandidateCosts<float> rest{channels, pixels, data<float>(features), data<float>(disparity), copy, extremes};
  anynet::candidate_costs(isa, rest, threads);
  return out;
}

Tensor expected_disparity(const Tensor& cost, const Tensor& disparity, const Tensor& offsets, int64_t first) {
  check_contiguous("expected_disparity", "cost", cost, 4);
  check_contiguous("expected_disparity", "disparity", disparity, 4);
  check_contiguous("expected_disparity", "offsets", offsets, 4);
  const int64_t count = cost.size(1), height = cost.size(2), width = cost.size(3);
  ANYNET_CHECK(cost.size(0) == 1 && count >= 2, "expected_disparity: expected cost of shape [1, 2 or more, H, W], got ",
               shape(cost));
  check_tensor("expected_disparity", "disparity", disparity, {1, 1, height, width}, cost);
  check_tensor("expected_disparity", "offsets", offsets, {1, 2, height, width}, cost);
  Tensor out = contiguous_like(disparity);
  const ExpectedDisparity<float> args{count,
                                      height * width,
                                      data<float>(cost),
                                      data<float>(disparity),
                                      data<float>(offsets),
                                      static_cast<float>(first),
                                      data<float>(out)};
  anynet::expected_disparity(chosen_isa(), args, num_threads());
  return out;
}

Tensor convex_upsampling(const Tensor& input, const Tensor& logits) {
  check_contiguous("convex_upsampling", "input", input, 4);
  check_contiguous("convex_upsampling", "logits", logits, 4);
  const int64_t n = input.size(0), height = input.size(2), width = input.size(3);
  check_tensor("convex_upsampling", "input", input, {n, 1, height, width}, input);
  check_tensor("convex_upsampling", "logits", logits, {n, 32, height, width}, input);
  Tensor out = empty_like(input, {n, 1, 2 * height, 2 * width});
  if (out.numel() == 0) return out;
  const ConvexUpsampling<float> args{n, height, width, data<float>(input), data<float>(logits), data<float>(out)};
  anynet::convex_upsampling(chosen_isa(), args, num_threads());
  return out;
}

Tensor read_image(const Tensor& image, const Tensor& mean, const Tensor& std, int64_t factor, int64_t block,
                  int64_t height, int64_t width) {
  check_image("read_image", image);
  check_contiguous("read_image", "mean", mean, 1);
  check_tensor("read_image", "mean", mean, {3}, mean);
  check_contiguous("read_image", "std", std, 1);
  check_tensor("read_image", "std", std, {3}, mean);
  ANYNET_CHECK(factor == 1 || factor == 2 || factor == 4, "read_image: expected factor 1, 2 or 4, got ", factor);
  ANYNET_CHECK(block == 1 || block == 2, "read_image: expected block 1 or 2, got ", block);
  ANYNET_CHECK(height > 0 && width > 0, "read_image: expected a size of at least one pixel, got ", height, " x ",
               width);
  Tensor out = empty_like(mean, {1, 3 * block * block, height, width});
  const ReadImage<float> args{data<uint8_t>(image), image.size(0),    image.size(1),   factor, block, height, width,
                              data<float>(mean),    data<float>(std), data<float>(out)};
  anynet::read_image(chosen_isa(), args, num_threads());
  return out;
}

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  m.def("upsample_concat(Tensor skip, Tensor coarse, Tensor scale, Tensor shift) -> Tensor",
        {at::Tag::pt2_compliant_tag});
  m.def("upsample_add(Tensor input, Tensor coarse, Tensor scale, Tensor shift) -> Tensor",
        {at::Tag::pt2_compliant_tag});
  m.def(
      "cost_volume_affine_relu(Tensor left, Tensor right, Tensor? disparity, int first, int last, Tensor scale, "
      "Tensor shift) -> Tensor",
      {at::Tag::pt2_compliant_tag});
  m.def("max_pool(Tensor input, Tensor scale, Tensor shift) -> Tensor", {at::Tag::pt2_compliant_tag});
  m.def("normalized_propagation(Tensor input, Tensor gates, int direction) -> Tensor", {at::Tag::pt2_compliant_tag});
  m.def("fill_occlusions(Tensor disparity, float pixel) -> Tensor", {at::Tag::pt2_compliant_tag});
  m.def("candidate_costs(Tensor features, Tensor disparity, int groups, int first, int last, int radius) -> Tensor",
        {at::Tag::pt2_compliant_tag});
  m.def("expected_disparity(Tensor cost, Tensor disparity, Tensor offsets, int first) -> Tensor",
        {at::Tag::pt2_compliant_tag});
  m.def("convex_upsampling(Tensor input, Tensor logits) -> Tensor", {at::Tag::pt2_compliant_tag});
  m.def(
      "read_image(Tensor image, Tensor mean, Tensor std, int factor, int block, SymInt height, SymInt width) -> "
      "Tensor",
      {at::Tag::pt2_compliant_tag});
  m.def("upsample_sum(Tensor[] maps, int[] ratios, float gain, SymInt height, SymInt width) -> Tensor",
        {at::Tag::pt2_compliant_tag});
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) {
  m.impl("upsample_sum", TORCH_BOX(&upsample_sum));
  m.impl("upsample_concat", TORCH_BOX(&upsample_concat));
  m.impl("upsample_add", TORCH_BOX(&upsample_add));
  m.impl("cost_volume_affine_relu", TORCH_BOX(&cost_volume_affine_relu));
  m.impl("max_pool", TORCH_BOX(&max_pool));
  m.impl("normalized_propagation", TORCH_BOX(&normalized_propagation));
  m.impl("fill_occlusions", TORCH_BOX(&fill_occlusions));
  m.impl("candidate_costs", TORCH_BOX(&candidate_costs));
  m.impl("expected_disparity", TORCH_BOX(&expected_disparity));
  m.impl("convex_upsampling", TORCH_BOX(&convex_upsampling));
  m.impl("read_image", TORCH_BOX(&read_image));
}

}  // namespace anynet::ops
