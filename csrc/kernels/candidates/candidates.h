// The candidates of a residual stage and their matching costs. Around an estimate d these are the residuals first, ...,
// first + count - 1 and, to propagate good disparities as PatchMatch stereo does (Bleyer et al., BMVC 2011), the
// largest and the smallest disparity within `radius` rows and columns.
//
// With cost[g](d) the cost volume (cost_volume.h) of the g-th group of channels around d, candidate_costs writes
//
//   out = [ cost[0](d + first), ..., cost[0](d + first + count - 1), cost[1](d + first), ...,
//           cost[0](max d), ..., cost[groups - 1](max d), cost[0](min d), ..., cost[groups - 1](min d),
//           left, max d - d, min d - d ]
//
// and expected_disparity weighs the candidates by the costs that a network makes of that:
//
//   out = d + sum_k softmax(-cost)[k] residual[k],   residual = first, first + 1, ..., offsets[0], offsets[1]
#pragma once

#include "../common/isa.h"

namespace anynet {

template <class T>
struct CandidateCosts {
  int64_t channels, groups, height, width;  // groups divides channels
  const T* features;                        // [2,C,H,W], contiguous: left, right
  const T* disparity;                       // [H,W], contiguous
  int64_t first, count;                     // of the residuals
  int64_t radius;
  T* out;  // [groups * (count + 2) + C + 2, H, W]
};

template <class T>
struct ExpectedDisparity {
  int64_t count, pixels;  // of the residuals, all of them
  const T* cost;          // [count,H,W], contiguous
  const T* disparity;     // [H,W], contiguous
  const T* offsets;       // [2,H,W], contiguous
  T first;
  T* out;  // [H,W]
};

ANYNET_DECLARE_KERNEL(candidate_costs, CandidateCosts)
ANYNET_DECLARE_KERNEL(expected_disparity, ExpectedDisparity)

}  // namespace anynet
