// Occlusions, found from a left disparity map alone, and filled from the background beside them, row by row:
//
//   p[x]           = x - disparity[x] / pixel                                   column in the right image
//   out_of_view[x] = clamp(-p[x] / 2, 0, 1)                                     beyond the right image's left border
//   occluded[x]    = clamp((p[x] - min_{x' >= x} p[x'] - 1/2) / 2, 0, 1)        behind a nearer surface
//
// First out-of-view pixels take the value of their right neighbor, from right to left, then occluded ones that are not
// out of view that of their left neighbor, from left to right; each by its fraction. The masks rise over two pixels, so
// that rounding cannot make a pixel jump from one surface to another.
#pragma once

#include "../common/isa.h"

namespace anynet {

template <class T>
struct FillOcclusions {
  int64_t rows, width;
  const T* disparity;  // [rows, width], contiguous
  T pixel;             // the width of a column in disparity's unit
  T* out;              // [rows, width]
};

ANYNET_DECLARE_KERNEL(fill_occlusions, FillOcclusions)

}  // namespace anynet
