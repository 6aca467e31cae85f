#include "../kernels/upsample/upsample.h"

#include <vector>

#include "backend.h"

namespace anynet::ops {
namespace {

/// Of a result of that size, which is not there yet.
UpsampleSum<float> sum_args(const std::vector<Tensor>& maps, const std::vector<int64_t>& ratios,
                            const std::vector<double>& gains, double side, int64_t height, int64_t width) {
  ANYNET_CHECK(!maps.empty() && maps.size() <= max_maps && maps.size() == ratios.size() &&
                   (gains.empty() || maps.size() == gains.size()),
               "upsample_sum: expected 1 to ", max_maps, " maps, as many ratios, and as many gains or none, got ",
               maps.size(), ", ", ratios.size(), " and ", gains.size());
  ANYNET_CHECK(side >= 0 && side <= 0.5 && (side == 0 || ratios.back() == 1),
               "upsample_sum: expected side 0 to 0.5, and 0 if the last ratio is not 1, got ", side);
  check_size("upsample_sum", height, width);
  UpsampleSum<float> args{};
  args.count = static_cast<int>(maps.size());
  for (int i = 0; i < args.count; ++i) {
    const Tensor& map = maps[i];
    check_contiguous("upsample_sum", "maps", map, 2);
    check_device("upsample_sum", "maps", map, maps[0]);
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
    args.gain[i] = gains.empty() ? 1 : static_cast<float>(gains[i]);
  }
  args.side = static_cast<float>(side);
  args.out_height = height;
  args.out_width = width;
  return args;
}

Tensor upsample_sum(const std::vector<Tensor>& maps, const std::vector<int64_t>& ratios,
                    const std::vector<double>& gains, double side, int64_t height, int64_t width) {
  UpsampleSum<float> args = sum_args(maps, ratios, gains, side, height, width);
  Tensor out = new_tensor(maps[0], {height, width});
  args.out = data<float>(out);
  ANYNET_RUN(upsample_sum, args, out);
  return out;
}

void upsample_sum_out(const std::vector<Tensor>& maps, const std::vector<int64_t>& ratios,
                      const std::vector<double>& gains, double side, const Tensor& out) {
  check_contiguous("upsample_sum", "out", out, 2);
  UpsampleSum<float> args = sum_args(maps, ratios, gains, side, out.size(0), out.size(1));
  check_device("upsample_sum", "out", out, maps[0]);
  args.out = data<float>(out);
  for (int i = 0; i < args.count; ++i) {
    ANYNET_CHECK(args.map[i] + maps[i].numel() <= args.out || args.out + out.numel() <= args.map[i],
                 "upsample_sum: expected out apart from the maps in memory, got a part of number ", i, " of them");
  }
  ANYNET_RUN(upsample_sum, args, out);
}

Tensor upsample_concat(const Tensor& skip, const Tensor& coarse, const Tensor& scale, const Tensor& shift) {
  check_contiguous("upsample_concat", "skip", skip, 4);
  check_contiguous("upsample_concat", "coarse", coarse, 4);
  check_device("upsample_concat", "coarse", coarse, skip);
  ANYNET_CHECK(skip.size(0) == coarse.size(0), "upsample_concat: expected coarse of skip's batch size, ", skip.size(0),
               ", got ", shape(coarse));
  check_size("upsample_concat", coarse.size(2), coarse.size(3));
  const int64_t channels = skip.size(1) + coarse.size(1);
  const AffineRelu<float> epilogue = affine_relu("upsample_concat", scale, shift, channels, skip);
  Tensor out = new_tensor(skip, {skip.size(0), channels, skip.size(2), skip.size(3)});
  if (out.numel() == 0) return out;
  const UpsampleConcat<float> args{skip.size(0),        skip.size(1),   coarse.size(1),  skip.size(2),
                                   skip.size(3),        coarse.size(2), coarse.size(3),  data<float>(skip),
                                   data<float>(coarse), epilogue,       data<float>(out)};
  ANYNET_RUN(upsample_concat, args, skip);
  return out;
}

Tensor upsample_add(const Tensor& input, const Tensor& coarse, const Tensor& scale, const Tensor& shift) {
  check_contiguous("upsample_add", "input", input, 5);
  check_contiguous("upsample_add", "coarse", coarse, 5);
  check_device("upsample_add", "coarse", coarse, input);
  ANYNET_CHECK(input.size(0) == coarse.size(0) && input.size(1) == coarse.size(1) && coarse.size(2) > 0,
               "upsample_add: expected coarse of input's batch size and channels, ", input.size(0), " and ",
               input.size(1), ", and at least one plane, got ", shape(coarse));
  check_size("upsample_add", coarse.size(3), coarse.size(4));
  const AffineRelu<float> epilogue = affine_relu("upsample_add", scale, shift, input.size(1), input);
  Tensor out = new_like(input);
  if (out.numel() == 0) return out;
  const UpsampleAdd<float> args{input.size(0),      input.size(1),       input.size(2),  input.size(3),
                                input.size(4),      coarse.size(2),      coarse.size(3), coarse.size(4),
                                data<float>(input), data<float>(coarse), epilogue,       data<float>(out)};
  ANYNET_RUN(upsample_add, args, input);
  return out;
}

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(
      m, "upsample_sum(Tensor[] maps, int[] ratios, float[] gains, float side, SymInt height, SymInt width) -> Tensor");
  ANYNET_SCHEMA(m, "upsample_sum.out(Tensor[] maps, int[] ratios, float[] gains, float side, *, Tensor(a!) out) -> ()");
  ANYNET_SCHEMA(m, "upsample_concat(Tensor skip, Tensor coarse, Tensor scale, Tensor shift) -> Tensor");
  ANYNET_SCHEMA(m, "upsample_add(Tensor input, Tensor coarse, Tensor scale, Tensor shift) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("upsample_sum", TORCH_BOX(&upsample_sum));
  m.impl("upsample_sum.out", TORCH_BOX(&upsample_sum_out));
  m.impl("upsample_concat", TORCH_BOX(&upsample_concat));
  m.impl("upsample_add", TORCH_BOX(&upsample_add));
}

}  // namespace anynet::ops
