// Where the operators of a translation unit run. Each csrc/ops/<op>.cpp is compiled for the CPU (_C), for CUDA
// (_C_cuda, with ANYNET_OPS_CUDA) and, for the tests, once more with the CUDA kernels on the CPU (ANYNET_OPS_EMULATED).
//
// ANYNET_RUN(kernel, args, tensor) runs kernels/<op>'s `kernel` where `tensor` is.
#pragma once

#include "tensor.h"

#ifdef ANYNET_OPS_CUDA

#include <torch/csrc/stable/accelerator.h>

#define ANYNET_NAMESPACE anynet
#define ANYNET_DISPATCH_KEY CUDA
#define ANYNET_RUN(kernel, args, tensor)                                                               \
  do {                                                                                                 \
    const torch::stable::accelerator::DeviceIndex device = (tensor).get_device_index();                \
    const torch::stable::accelerator::DeviceGuard guard(device);                                       \
    ::anynet::cuda::kernel(args, torch::stable::accelerator::getCurrentStream(device).nativeHandle()); \
  } while (false)

#else

#ifdef ANYNET_OPS_EMULATED
#define ANYNET_NAMESPACE anynet_cuda_emulated
#define ANYNET_RUN(kernel, args, tensor) ::anynet::cuda::kernel(args, nullptr)
#else
#define ANYNET_NAMESPACE anynet
#define ANYNET_RUN(kernel, args, tensor) ::anynet::kernel(chosen_isa(), args, num_threads())
#endif
#define ANYNET_DISPATCH_KEY CPU
#define ANYNET_DEFINE_SCHEMAS  // CUDA implements those that _C defines

#endif
