// Batch norm by the batch's own statistics, then ReLU, in training (Ioffe and Szegedy 2015, algorithm 1).
//
//   mean[c], variance[c] over n and p of input[n,c,p];   d = 1 / sqrt(variance + eps)
//   out[n,c,p] = relu( weight[c] d (input[n,c,p] - mean[c]) + bias[c] )
//
// With g the gradient that arrives where out came from above 0, and 0 elsewhere, and M = N P:
//
//   grad_bias[c] = sum g,   grad_weight[c] = d sum g (input - mean)
//   grad_input = weight d (g - grad_bias / M - (input - mean) d grad_weight / M)
//
// A channel is summed in pieces that depend on the shape alone, those of a piece in T, the pieces in double, so that
// results repeat bit for bit whatever the number of threads.
#pragma once

#include "../common/isa.h"
#include "../common/tensor.h"

namespace anynet {

template <class T>
struct BatchNormRelu {
  int64_t batch, channels, pixels;
  const T* input;   // [N,C,P], contiguous
  const T* weight;  // [C]
  const T* bias;    // [C]
  double eps;
  T* out;                  // [N,C,P], contiguous
  T* mean;                 // [C]
  T* variance;             // [C], of the batch: over M
  double* sums = nullptr;  // for CUDA: cuda::batch_norm_sums elements to work with
};

template <class T>
struct BatchNormReluBackward {
  int64_t batch, channels, pixels;
  const T* grad;   // [N,C,P], contiguous
  const T* input;  // [N,C,P], contiguous
  const T* weight;
  const T* bias;
  const T* mean;
  const T* variance;
  double eps;
  T* grad_input;  // [N,C,P], contiguous
  T* grad_weight;
  T* grad_bias;
  double* sums = nullptr;  // as above
};

namespace cuda {
int64_t batch_norm_sums(int64_t batch, int64_t channels, int64_t pixels);
}

ANYNET_DECLARE_KERNEL(batch_norm_relu, BatchNormRelu)
ANYNET_DECLARE_KERNEL(batch_norm_relu_backward, BatchNormReluBackward)

}  // namespace anynet
