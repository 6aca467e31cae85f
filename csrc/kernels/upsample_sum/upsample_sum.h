// Several small maps, each enlarged to one size, and added: the disparity map that the stages' results make up.
//
//   out[y,x] = gain * sum_i bilinear(map_i, (y + 1/2) / ratio_i - 1/2, (x + 1/2) / ratio_i - 1/2)
//
// Bilinear interpolation with the pixels as areas (PyTorch's align_corners=False), beyond the border the border's value.
#pragma once

#include "../common/isa.h"

namespace anynet {

constexpr int max_maps = 8;

template <class T>
struct UpsampleSum {
  int count;               // of maps, at most max_maps
  const T* map[max_maps];  // [height[i], width[i]], contiguous
  int64_t height[max_maps], width[max_maps], ratio[max_maps];
  T gain;
  int64_t out_height, out_width;  // not more than ratio * height, ratio * width
  T* out;                         // [out_height, out_width]
};

ANYNET_DECLARE_KERNEL(upsample_sum, UpsampleSum)

}  // namespace anynet
