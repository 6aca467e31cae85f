// Facts about this build, for anynet_ext.build_info(). Plain C, read through ctypes.
#include <exception>
#include <string>

#include "../kernels/common/isa.h"

#define ANYNET_EXPORT __attribute__((visibility("default")))

extern "C" {

/// Why no instruction set can be used; empty if one can.
ANYNET_EXPORT const char* anynet_isa_error() {
  static const std::string error = []() -> std::string {
    try {
      anynet::chosen_isa();
      return "";
    } catch (const std::exception& caught) {
      return caught.what();
    }
  }();
  return error.c_str();
}

/// Name of the instruction set in use, where there is no error.
ANYNET_EXPORT const char* anynet_isa() { return anynet::isa_name(anynet::chosen_isa()); }

/// Names of the instruction sets built into this library, separated by spaces.
ANYNET_EXPORT const char* anynet_isa_built() {
  static const std::string names =
      anynet::isa_name(anynet::Isa::baseline) + std::string("" ANYNET_IF_AVX2(" avx2") ANYNET_IF_AVX512(" avx512"));
  return names.c_str();
}

ANYNET_EXPORT const char* anynet_build_config() { return ANYNET_BUILD_CONFIG; }
}
