#include "../kernels/candidates/candidates.h"

#include "backend.h"

namespace anynet::ops {
namespace {

constexpr int64_t max_radius = 1024;

Tensor candidate_costs(const Tensor& features, const Tensor& disparity, int64_t groups, int64_t first, int64_t last,
                       int64_t radius) {
  check_contiguous("candidate_costs", "features", features, 4);
  check_contiguous("candidate_costs", "disparity", disparity, 4);
  const int64_t channels = features.size(1), height = features.size(2), width = features.size(3);
  check_tensor("candidate_costs", "features", features, {2, channels, height, width}, features);
  check_tensor("candidate_costs", "disparity", disparity, {1, 1, height, width}, features);
  ANYNET_CHECK(groups > 0 && groups <= channels && channels % groups == 0,  // any number divides 0
               "candidate_costs: expected groups to divide the ", channels, " channels, got ", groups);
  ANYNET_CHECK(first <= last, "candidate_costs: expected first <= last, got first ", first, " and last ", last);
  int64_t span;
  ANYNET_CHECK(!__builtin_sub_overflow(last, first, &span) && span < max_size && width < max_size - span,
               "candidate_costs: expected at most 2^30 columns and residuals, got first ", first, ", last ", last,
               " and features ", shape(features));
  ANYNET_CHECK(0 <= radius && radius <= max_radius, "candidate_costs: expected a radius of 0 to ", max_radius, ", got ",
               radius);
  Tensor out = new_tensor(features, {1, groups * (span + 3) + channels + 2, height, width});
  if (out.numel() == 0) return out;
  const CandidateCosts<float> args{
      channels, groups,   height, width,           data<float>(features), data<float>(disparity),
      first,    span + 1, radius, data<float>(out)};
  ANYNET_RUN(candidate_costs, args, features);
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
  Tensor out = new_like(disparity);
  const ExpectedDisparity<float> args{count,
                                      height * width,
                                      data<float>(cost),
                                      data<float>(disparity),
                                      data<float>(offsets),
                                      static_cast<float>(first),
                                      data<float>(out)};
  ANYNET_RUN(expected_disparity, args, cost);
  return out;
}

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(
      m, "candidate_costs(Tensor features, Tensor disparity, int groups, int first, int last, int radius) -> Tensor");
  ANYNET_SCHEMA(m, "expected_disparity(Tensor cost, Tensor disparity, Tensor offsets, int first) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("candidate_costs", TORCH_BOX(&candidate_costs));
  m.impl("expected_disparity", TORCH_BOX(&expected_disparity));
}

}  // namespace anynet::ops
