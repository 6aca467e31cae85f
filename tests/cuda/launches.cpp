// torch.ops.anynet_cuda_emulated.launches(): how many kernels the emulator has run.
#include <cuda_runtime.h>
#include <torch/csrc/stable/library.h>

namespace {

int64_t launches() { return emulator::launches(); }

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(anynet_cuda_emulated, m) { m.def("launches() -> int"); }

STABLE_TORCH_LIBRARY_IMPL(anynet_cuda_emulated, CompositeExplicitAutograd, m) {
  m.impl("launches", TORCH_BOX(&launches));
}
