// Warping by a disparity map: the right image as the left camera would see it (AnyNet paper, section III-C).
//
//   out[n,c,y,x] = image[n,c,y,p],   p = x - disparity[n,0,y,x]
//
// Sampling is linear in p: with i = floor(p), f = p - i, image[p] = (1 - f) image[i] + f image[i + 1], where pixels
// outside the row count as 0. NaN disparity gives NaN and passes no gradient. With g the gradient that arrives for out:
//
//   grad_image[n,c,y,i] = sum over x of g[n,c,y,x] max(0, 1 - |p(x) - i|)
//   grad_disparity[n,0,y,x] = -sum_c g[n,c,y,x] (image[i + 1] - image[i])     (right-sided where p is an integer)
//
// Positions stay within their row, so the backward pass needs no atomics: one thread owns a row.
#pragma once

#include "../common/isa.h"
#include "../common/tensor.h"

namespace anynet {

template <class T>
struct Warp {
  View4<const T> image;      // [N,C,H,W], any strides
  View4<const T> disparity;  // [N,1,H,W], any strides
  T* out;                    // [N,C,H,W], contiguous
};

template <class T>
struct WarpBackward {
  View4<const T> grad;       // [N,C,H,W], any strides
  View4<const T> image;      // [N,C,H,W], any strides
  View4<const T> disparity;  // [N,1,H,W], any strides
  T* grad_image;             // [N,C,H,W], contiguous
  T* grad_disparity;         // [N,1,H,W], contiguous
};

ANYNET_DECLARE_KERNEL(warp, Warp)
ANYNET_DECLARE_KERNEL(warp_backward, WarpBackward)

}  // namespace anynet
