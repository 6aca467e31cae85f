// What lies between the convolutions of the deployed network, each in one pass over its data. Forward only.
#pragma once

#include "../common/isa.h"

namespace anynet {

/// Small maps, each enlarged to one size, and added: the disparity map that the stages' results make up.
///
///   out[y,x] = gain * sum_i bilinear(map_i, (y + 1/2) / ratio_i - 1/2, (x + 1/2) / ratio_i - 1/2)
///
/// Pixels are areas (PyTorch's align_corners=False); beyond the border lies the border's value.
constexpr int max_maps = 8;
template <class T>
struct UpsampleSum {
  int count;                                                   // of maps, at most max_maps
  const T* map[max_maps];                                      // [height[i], width[i]], contiguous
  int64_t height[max_maps], width[max_maps], ratio[max_maps];  // ratios are powers of two
  T gain;
  int64_t out_height, out_width;  // not more than ratio * height, ratio * width
  T* out;                         // [out_height, out_width]
};

/// The U-Net's way up, as far as its next convolution: skip connection and enlarged coarser features, one after the
/// other, through a per-channel affine and ReLU. Pixels are points, the corners' kept (PyTorch's align_corners=True).
template <class T>
struct UpsampleConcat {
  int64_t batch, skip_channels, coarse_channels;
  int64_t height, width, coarse_height, coarse_width;
  const T* skip;    // [N,S,H,W], contiguous
  const T* coarse;  // [N,C,h,w], contiguous
  const T* scale;   // [S+C]
  const T* shift;   // [S+C]
  T* out;           // [N,S+C,H,W]
};

/// An hourglass's way up, as far as the next convolution: a volume plus a coarser one, enlarged, through a per-channel
/// affine and ReLU. Trilinear; pixels are areas (PyTorch's align_corners=False).
template <class T>
struct UpsampleAdd {
  int64_t batch, channels;
  int64_t depth, height, width, coarse_depth, coarse_height, coarse_width;
  const T* input;   // [N,C,D,H,W], contiguous
  const T* coarse;  // [N,C,d,h,w], contiguous
  const T* scale;   // [C]
  const T* shift;   // [C]
  T* out;           // [N,C,D,H,W]
};

/// out = max(0, scale[c] * maxpool2x2(in) + shift[c])
template <class T>
struct MaxPool {
  int64_t batch, channels, height, width;  // of the input; an odd last row or column is left out
  const T* in;                             // [N,C,H,W], contiguous
  const T* scale;                          // [C]
  const T* shift;                          // [C]
  T* out;                                  // [N,C,H/2,W/2]
};

/// Disparity with what the right camera does not see filled from beside it, row by row.
///
///   lands[x]   = x - d[x]                                                     column in the right image
///   outside[x] = clamp(-lands[x] / 2, 0, 1)                                   takes f[x+1], from right to left
///   behind[x]  = clamp((lands[x] - min_{x' >= x} lands[x'] - 1/2) / 2, 0, 1)  takes out[x-1], from left to right
template <class T>
struct FillOcclusions {
  int64_t rows, width;
  const T* disparity;  // [rows, width], contiguous
  T pixel;             // of its unit per column
  T* out;              // [rows, width]
};

/// The largest and the smallest value within `radius` rows and columns of each pixel.
template <class T>
struct WindowExtremes {
  int64_t height, width, radius;
  const T* in;  // [H,W], contiguous
  T* out;       // [2,H,W]: largest, smallest
};

/// What is left of a residual stage's picture, beside its cost volumes: features copied, extremes made offsets.
template <class T>
struct CandidateCosts {
  int64_t channels, pixels;
  const T* features;   // [C,H,W], contiguous
  const T* disparity;  // [H,W], contiguous
  T* copy;             // [C,H,W]
  T* offsets;          // [2,H,W]: extremes before, less the disparity after
};

/// out = disparity + sum_k softmax(-cost)[k] residual[k]; the residuals are first, first + 1, ..., offsets[0],
/// offsets[1]
template <class T>
struct ExpectedDisparity {
  int64_t count, pixels;  // of the residuals, all of them
  const T* cost;          // [count,H,W], contiguous
  const T* disparity;     // [H,W], contiguous
  const T* offsets;       // [2,H,W], contiguous
  T first;
  T* out;  // [H,W]
};

/// Twice the size: each of the four pixels that one becomes is a mean of the nine around it, by the softmax of its
/// logits. Beyond the border lies the border's value.
template <class T>
struct ConvexUpsampling {
  int64_t batch, height, width;
  const T* in;      // [N,1,H,W], contiguous
  const T* logits;  // [N,32,H,W], contiguous: of each of the four, of its eight neighbours; row by row. Its own is 0.
  T* out;           // [N,1,2H,2W]
};

/// The image at its size, half or a quarter of it, bilinear (so: the mean of the middle 2x2 of each 2x2 or 4x4), and
/// normalised: small[c] = (image[c] - mean[c]) / std[c]; then its blocks of `block` x `block` pixels as so many
/// channels: out[c, i, j, y, x] = small[c, block y + i, block x + j]. Beyond the image its last row and column go on.
template <class T>
struct ReadImage {
  const uint8_t* image;  // RGB, [image_height, image_width, 3], contiguous
  int64_t image_height, image_width;
  int64_t factor;         // 1, 2 or 4
  int64_t block;          // 1 or 2
  int64_t height, width;  // of the output
  const T* mean;          // [3], in bytes' units, as std
  const T* std;           // [3]
  T* out;                 // [3,block,block,height,width]
};

ANYNET_DECLARE_KERNEL(upsample_sum, UpsampleSum)
ANYNET_DECLARE_KERNEL(upsample_concat, UpsampleConcat)
ANYNET_DECLARE_KERNEL(upsample_add, UpsampleAdd)
ANYNET_DECLARE_KERNEL(max_pool, MaxPool)
ANYNET_DECLARE_KERNEL(fill_occlusions, FillOcclusions)
ANYNET_DECLARE_KERNEL(window_extremes, WindowExtremes)
ANYNET_DECLARE_KERNEL(candidate_costs, CandidateCosts)
ANYNET_DECLARE_KERNEL(expected_disparity, ExpectedDisparity)
ANYNET_DECLARE_KERNEL(convex_upsampling, ConvexUpsampling)
ANYNET_DECLARE_KERNEL(read_image, ReadImage)

}  // namespace anynet
