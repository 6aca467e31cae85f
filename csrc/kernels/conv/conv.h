// Direct 3x3 and 3x3x3 convolutions of few channels (1 to 64), with what the network needs fused into them.
//
//   out[n,o,q] = relu_out( bias[o] + sum_c sum_t weight[o,c,t] a[n,c, stride q + t - 1] ),   t in {0,1,2}^2 or ^3
//   a[n,c,p] = relu_in( scale[c] input[n,c,p] + shift[c] ) inside the image, 0 outside (zero padding after the affine)
//
// 2-D tensors are 3-D ones with D = 1 and a kernel of depth 1. The layout is PyTorch's own, [N,C,D,H,W] contiguous:
// output pixels of one row lie in the vector registers, several output channels at a time, so that no layer ever needs
// its data reordered, and borders are vectors with some lanes off, not padded copies.
#pragma once

#include "../common/isa.h"
#include "../common/tensor.h"

namespace anynet {

struct ConvShape {
  int64_t batch, in_channels, out_channels;
  int64_t depth, height, width;  // of the input; depth 1 and kernel_depth 1 for 2-D
  int64_t kernel_depth;          // 1 or 3; the kernel is 3 x 3 across
  int64_t stride;                // 1 or 2, along every spatial dimension (depth only if kernel_depth is 3)
};

template <class T>
struct Conv {
  ConvShape shape;
  const T* input;   // [N,C,D,H,W], contiguous
  const T* weight;  // [O,C,kd,3,3], contiguous
  const T* bias;    // [O] or nullptr
  const T* scale;   // [C] or nullptr: no affine (then shift is nullptr too)
  const T* shift;   // [C]
  bool relu_in, relu_out;
  T* out;  // [N,O,D',H',W'], contiguous, D' = (D - 1) / stride + 1 and so on
};

/// Two convolutions of stride 1 with a ReLU between them:
///
///   out = relu_out( bias_second + weight_second * max(0, bias_first + weight_first * input) )
///
/// On CUDA they are one launch where what a tile needs of `input` and of what lies between fits into shared memory
/// (`conv_pair_fits`); nothing of the latter goes through memory. Elsewhere they are two convolutions.
template <class T>
struct ConvPair {
  ConvShape shape;         // of the first one
  int64_t out_channels;    // O, of the second one
  const T* input;          // [N,C,D,H,W], contiguous
  const T* weight_first;   // [M,C,kd,3,3]
  const T* bias_first;     // [M] or nullptr
  const T* weight_second;  // [O,M,kd,3,3]
  const T* bias_second;    // [O] or nullptr
  bool relu_out;
  T* out;  // [N,O,D,H,W]
};

template <class T>
struct ConvBackwardInput {
  ConvShape shape;
  const T* grad;    // [N,O,D',H',W'], contiguous
  const T* weight;  // [O,C,kd,3,3], contiguous
  const T* before;  // [N,C,D,H,W], contiguous, or nullptr: what the ReLU before the convolution saw
  T* grad_input;    // [N,C,D,H,W], contiguous
};

template <class T>
struct ConvBackwardWeight {
  ConvShape shape;
  const T* grad;   // [N,O,D',H',W'], contiguous
  const T* input;  // [N,C,D,H,W], contiguous
  const T* scale;  // [C] or nullptr, as in Conv
  const T* shift;  // [C]
  bool relu_in;
  T* grad_weight;  // [O,C,kd,3,3], contiguous
  T* grad_bias;    // [O], or nullptr
};

ANYNET_DECLARE_KERNEL(conv, Conv)
ANYNET_DECLARE_KERNEL(conv_backward_input, ConvBackwardInput)
ANYNET_DECLARE_KERNEL(conv_backward_weight, ConvBackwardWeight)

namespace cuda {
bool conv_pair_fits(const ConvShape& first);
void conv_pair(const ConvPair<float>& args, Stream stream);
}  // namespace cuda

}  // namespace anynet
