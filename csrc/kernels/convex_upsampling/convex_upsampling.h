// Convex upsampling by two (Teed and Deng, "RAFT", arXiv 2003.12039, section 3.3): each of the four pixels that one
// becomes is a mean of the 3x3 around it, weighted by the softmax of its logits.
#pragma once

#include "../common/isa.h"

namespace anynet {

template <class T>
struct ConvexUpsampling {
  int64_t batch, height, width;
  const T* in;  // [N,1,H,W], contiguous, padded by replication
  const T*
      logits;  // [N,32,H,W], contiguous: per output pixel, row by row, of its 8 neighbors, row by row; its own is 0
  T* out;      // [N,1,2H,2W]
};

ANYNET_DECLARE_KERNEL(convex_upsampling, ConvexUpsampling)

}  // namespace anynet
