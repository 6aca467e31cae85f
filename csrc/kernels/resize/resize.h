// Bilinear resize, scaled and added to what is there already: how one stage's disparity reaches the next resolution.
//
//   out[n,c,y,x] = add[n,c,y,x] + scale * sum_ij wy_i(y) wx_j(x) input[n,c,i,j]
//
// Along each axis of `from` input and `to` output pixels, output q reads position p with i = floor(p) and weights
// 1 - (p - i) on i, p - i on i + 1 (the last pixel at most):
//
//   p = max(0, (q + 1/2) from / to - 1/2)     pixels are areas (align_corners false)
//   p = q (from - 1) / (to - 1)               corners meet corners (align_corners true)
//
// Backward gathers: an input row collects the few output rows that read it, then its columns likewise.
#pragma once

#include "../common/isa.h"
#include "../common/tensor.h"

namespace anynet {

template <class T>
struct Resize {
  View4<const T> input;   // [N,C,h,w], any strides, h and w >= 1
  View4<const T> add;     // [N,C,H,W], any strides; data == nullptr means 0 everywhere
  int64_t height, width;  // H, W
  double scale;
  bool align_corners;
  T* out;  // [N,C,H,W], contiguous
};

template <class T>
struct ResizeBackward {
  View4<const T> grad;    // [N,C,H,W], any strides
  int64_t height, width;  // h, w of the input
  double scale;
  bool align_corners;
  T* grad_input;  // [N,C,h,w], contiguous
};

ANYNET_DECLARE_KERNEL(resize, Resize)
ANYNET_DECLARE_KERNEL(resize_backward, ResizeBackward)

}  // namespace anynet
