// What steers the refinement: the left image, how the right one differs from it at the disparity, and that, for
// inference.
//
// With read(image, factor, block) of read_image.h, and warp of warp.h,
//
//   out = [ read(left, factor / block, block), warp(read(right, factor, 1), d) - read(left, factor, 1), d ],
//   d = disparity / factor
//
// In one pass, of which nothing but the result goes through memory.
#pragma once

#include "../common/isa.h"

namespace anynet {

template <class T>
struct RefinementGuide {
  const uint8_t* image[2];  // left and right: RGB, [image_height, image_width, 3], contiguous
  int64_t image_height, image_width;
  int64_t factor;         // 1, 2 or 4
  int64_t block;          // 1 or 2, which divides it
  int64_t height, width;  // of the disparity
  const T* disparity;     // [height,width], contiguous, in pixels of the images
  const T* mean;          // [3], in 8-bit units, as std
  const T* std;           // [3]
  T* out;                 // [3 block^2 + 4,height,width]
};

ANYNET_DECLARE_KERNEL(refinement_guide, RefinementGuide)

}  // namespace anynet
