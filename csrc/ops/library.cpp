// Facts about this build, for anynet_ext.build_info(). Plain C, read through ctypes.
#include "../kernels/common/isa.h"

#define ANYNET_EXPORT __attribute__((visibility("default")))

extern "C" {

/// Name of the instruction set in use; nullptr if ANYNET_ISA names one that cannot be used.
ANYNET_EXPORT const char* anynet_isa() {
  try {
    return anynet::isa_name(anynet::chosen_isa());
  } catch (...) {
    return nullptr;
  }
}

/// Names of the instruction sets built into this library, separated by spaces.
ANYNET_EXPORT const char* anynet_isa_built() { return "baseline" ANYNET_IF_AVX2(" avx2") ANYNET_IF_AVX512(" avx512"); }

ANYNET_EXPORT const char* anynet_build_config() { return ANYNET_BUILD_CONFIG; }
}
