// 2x2 max pooling with an epilogue: out = epilogue(max of in[2y..2y+1, 2x..2x+1]), as PyTorch's max_pool2d(in, 2).
#pragma once

#include "../common/affine_relu.h"
#include "../common/isa.h"

namespace anynet {

template <class T>
struct MaxPool {
  int64_t batch, channels, height, width;  // of the input; an odd last row or column is left out
  const T* in;                             // [N,C,H,W], contiguous
  AffineRelu<T> epilogue;                  // of C channels
  T* out;                                  // [N,C,H/2,W/2]
};

ANYNET_DECLARE_KERNEL(max_pool, MaxPool)

}  // namespace anynet
