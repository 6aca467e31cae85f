// Where the operators of a translation unit run. Each csrc/ops/<op>.cpp is compiled for the CPU (_C), for CUDA
// (_C_cuda, with ANYNET_OPS_CUDA) and, for the tests, once more with the CUDA kernels on the CPU (ANYNET_OPS_EMULATED).
//
// ANYNET_RUN(kernel, args, tensor) runs kernels/<op>'s `kernel` where `tensor` is.
#pragma once

#include "tensor.h"

#ifdef ANYNET_OPS_CUDA

#include <dlfcn.h>
#include <torch/csrc/stable/accelerator.h>

#include "../kernels/common/isa.h"

namespace anynet::ops {

/// PyTorch's current stream on that device. libtorch_cuda exports it in C, as all supported releases do; found at run
/// time, so that this library loads into the CPU build of PyTorch too.
inline cuda::Stream current_stream(torch::stable::accelerator::DeviceIndex device) {
  using Get = AOTITorchError (*)(int32_t, void**);
  static const Get get = [] {
    void* library = dlopen("libtorch_cuda.so", RTLD_LAZY | RTLD_NOLOAD);
    void* function = library == nullptr ? nullptr : dlsym(library, "aoti_torch_get_current_cuda_stream");
    if (function == nullptr) fail("expected libtorch_cuda.so with aoti_torch_get_current_cuda_stream, got none");
    return reinterpret_cast<Get>(function);
  }();
  cuda::Stream stream = nullptr;
  if (get(device, &stream) != AOTI_TORCH_SUCCESS) fail("no current CUDA stream on device ", device);
  return stream;
}

}  // namespace anynet::ops

#define ANYNET_NAMESPACE anynet
#define ANYNET_DISPATCH_KEY CUDA
#define ANYNET_RUN(kernel, args, tensor)                                                \
  do {                                                                                  \
    const torch::stable::accelerator::DeviceIndex device = (tensor).get_device_index(); \
    const torch::stable::accelerator::DeviceGuard guard(device);                        \
    ::anynet::cuda::kernel(args, current_stream(device));                               \
  } while (false)

#else

#ifdef ANYNET_OPS_EMULATED
#define ANYNET_NAMESPACE anynet_cuda_emulated
#define ANYNET_RUN(kernel, args, tensor) ::anynet::cuda::kernel(args, nullptr)
#else
#define ANYNET_OPS_CPU
#define ANYNET_NAMESPACE anynet
#define ANYNET_RUN(kernel, args, tensor) ::anynet::kernel(chosen_isa(), args, num_threads())
#endif
#define ANYNET_DISPATCH_KEY CPU
#define ANYNET_DEFINE_SCHEMAS  // CUDA implements those that _C defines

#endif
