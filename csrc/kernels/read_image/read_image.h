// An 8-bit image downsampled, normalized, and laid out as the network reads it:
//
//   small[c,y,x] = (image[c, factor (y + 1/2) - 1/2, factor (x + 1/2) - 1/2] - mean[c]) / std[c]
//   out[c,i,j,y,x] = small[c, block y + i, block x + j]
//
// Sampling is bilinear (PyTorch's align_corners=False), so that for factors 2 and 4 it is the mean of the middle 2x2 of
// each 2x2 or 4x4. Blocks of pixels become channels (pixel_unshuffle). The image is padded by replicating its last row
// and column.
#pragma once

#include "../common/isa.h"

namespace anynet {

template <class T>
struct ReadImage {
  const uint8_t* image;  // RGB, [image_height, image_width, 3], contiguous
  int64_t image_height, image_width;
  int64_t factor;         // 1, 2 or 4
  int64_t block;          // 1 or 2
  int64_t height, width;  // of the output
  const T* mean;          // [3], in 8-bit units, as std
  const T* std;           // [3]
  T* out;                 // [3,block,block,height,width]
};

ANYNET_DECLARE_KERNEL(read_image, ReadImage)

}  // namespace anynet
