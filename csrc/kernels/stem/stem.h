// The first layers of the network on images in bytes, in one pass (AnyNet paper, Table I), for inference.
//
//   x   = enlarged image - mean                         [3,H,W]; beyond the image go on its last row and column
//   f   = max(0, conv(x, weight_first) + bias_first)    3x3, padding 1 (zeros)
//   h   = conv(f, weight_second)                        3x3, padding 1 (zeros), stride 2
//   out = max(0, scale * maxpool2x2(h) + shift)         [C,H/4,W/4]
//
// Enlarging, to twice the size, is bilinear, and pixels are areas (PyTorch's align_corners=False).
// H and W are multiples of 4. Nothing of full or half resolution goes through memory: a thread keeps the five rows of f
// that two rows of h need. Columns lie apart by their remainder modulo 4, so that strides and pooling become arithmetic
// of whole vectors.
#pragma once

#include "../common/isa.h"

namespace anynet {

template <class T>
struct Stem {
  const uint8_t* image[2];  // left and right: RGB, [image_height, image_width, 3], contiguous
  int64_t image_height, image_width;
  int64_t input_scale;     // 1 or 2
  int64_t height, width;   // of x; multiples of 4, not less than the enlarged image's
  int64_t channels;        // C
  const T* mean;           // [3], in bytes' units
  const T* weight_first;   // [C,3,3,3]
  const T* bias_first;     // [C]
  const T* weight_second;  // [C,C,3,3]
  const T* scale;          // [C]
  const T* shift;          // [C]
  T* out;                  // [2,C,height/4,width/4]
};

ANYNET_DECLARE_KERNEL(stem, Stem)

}  // namespace anynet
