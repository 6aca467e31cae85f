// The first layers of the network on 8-bit images, in one pass (AnyNet paper, Table I), for inference.
//
//   x   = upsampled image - mean                        [3,H,W]; padded by replicating its last row and column
//   f   = max(0, conv(x, weight_first) + bias_first)    3x3, padding 1 (zeros)
//   h   = conv(f, weight_second)                        3x3, padding 1 (zeros), stride 2
//   out = epilogue(maxpool2x2(h))                       [C,H/4,W/4]
//
// Upsampling, to twice the size, is bilinear (PyTorch's align_corners=False).
// H and W are multiples of 4. Nothing of full or half resolution goes through memory: a thread keeps the five rows of f
// that two rows of h need. Columns are deinterleaved by 4, so that strides and pooling become arithmetic of whole
// vectors.
#pragma once

#include "../common/affine_relu.h"
#include "../common/isa.h"

namespace anynet {

template <class T>
struct Stem {
  const uint8_t* image[2];  // left and right: RGB, [image_height, image_width, 3], contiguous
  int64_t image_height, image_width;
  int64_t input_scale;     // 1 or 2
  int64_t height, width;   // of x; multiples of 4, not less than the upsampled image's
  int64_t channels;        // C
  const T* mean;           // [3], in 8-bit units
  const T* weight_first;   // [C,3,3,3]
  const T* bias_first;     // [C]
  const T* weight_second;  // [C,C,3,3]
  AffineRelu<T> epilogue;  // of C channels
  T* out;                  // [2,C,height/4,width/4]
};

ANYNET_DECLARE_KERNEL(stem, Stem)

}  // namespace anynet
