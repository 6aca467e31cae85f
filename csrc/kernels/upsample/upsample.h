// Upsampling fused with what follows it in the network: the sum of several maps, and the skip connections of the U-Net
// (concatenation) and of an hourglass (addition) with the epilogue before the next convolution.
#pragma once

#include "../common/affine_relu.h"
#include "../common/isa.h"

namespace anynet {

/// out[y,x] = sum_i gain_i bilinear(map_i, (y + 1/2) / ratio_i - 1/2, (x + 1/2) / ratio_i - 1/2)
///
/// Bilinear (PyTorch's align_corners=False); maps are padded by replication. The last map may be smoothed: along both
/// axes, each value becomes 1 - 2 side of itself and `side` of both its neighbors.
constexpr int max_maps = 8;
template <class T>
struct UpsampleSum {
  int count;                                                   // of maps, at most max_maps
  const T* map[max_maps];                                      // [height[i], width[i]], contiguous
  int64_t height[max_maps], width[max_maps], ratio[max_maps];  // ratios are powers of two
  T gain[max_maps];
  T side;                         // of the last map, whose ratio is then 1; 0: nothing is smoothed
  int64_t out_height, out_width;  // not more than ratio * height, ratio * width
  T* out;                         // [out_height, out_width]
};

/// out = epilogue(cat(skip, bilinear(coarse))), align_corners=True
template <class T>
struct UpsampleConcat {
  int64_t batch, skip_channels, coarse_channels;
  int64_t height, width, coarse_height, coarse_width;
  const T* skip;           // [N,S,H,W], contiguous
  const T* coarse;         // [N,C,h,w], contiguous
  AffineRelu<T> epilogue;  // of S + C channels
  T* out;                  // [N,S+C,H,W]
};

/// out = epilogue(input + trilinear(coarse)), align_corners=False
template <class T>
struct UpsampleAdd {
  int64_t batch, channels;
  int64_t depth, height, width, coarse_depth, coarse_height, coarse_width;
  const T* input;          // [N,C,D,H,W], contiguous
  const T* coarse;         // [N,C,d,h,w], contiguous
  AffineRelu<T> epilogue;  // of C channels
  T* out;                  // [N,C,D,H,W]
};

ANYNET_DECLARE_KERNEL(upsample_sum, UpsampleSum)
ANYNET_DECLARE_KERNEL(upsample_concat, UpsampleConcat)
ANYNET_DECLARE_KERNEL(upsample_add, UpsampleAdd)

}  // namespace anynet
