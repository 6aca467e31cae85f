// Instruction sets: which were built, which one this process uses, and how a kernel call finds its variant.
#pragma once

#include "tensor.h"

namespace anynet {

enum class Isa : int { baseline = 0, avx2 = 1, avx512 = 2 };

const char* isa_name(Isa isa);

/// True if `isa` was compiled into this library and this machine can run it.
bool isa_available(Isa isa);

/// The best available set, or the one that the environment variable ANYNET_ISA names (read once).
/// Throws std::runtime_error if ANYNET_ISA names a set that is unknown or not available.
Isa chosen_isa();

namespace cuda {
using Stream = void*;  // a cudaStream_t, without CUDA's headers
}  // namespace cuda

}  // namespace anynet

// Every CPU kernel is one template, compiled once per instruction set into a namespace of that set's name.
#ifdef ANYNET_BUILD_AVX2
#define ANYNET_IF_AVX2(...) __VA_ARGS__
#else
#define ANYNET_IF_AVX2(...)
#endif
#ifdef ANYNET_BUILD_AVX512
#define ANYNET_IF_AVX512(...) __VA_ARGS__
#else
#define ANYNET_IF_AVX512(...)
#endif

/// Declares `name<T>(args, threads)` in each set's namespace, `anynet::name<T>(isa, args, threads)` that calls one, and
/// `anynet::cuda::name<T>(args, stream)`, which name_cuda.cu defines where there is one.
#define ANYNET_DECLARE_KERNEL(name, Args)                                         \
  namespace cuda {                                                                \
  template <class T>                                                              \
  void name(const Args<T>& args, Stream stream);                                  \
  }                                                                               \
  namespace baseline {                                                            \
  template <class T>                                                              \
  void name(const Args<T>& args, int threads);                                    \
  }                                                                               \
  ANYNET_IF_AVX2(namespace avx2 {                                                 \
    template <class T>                                                            \
    void name(const Args<T>& args, int threads);                                  \
  })                                                                              \
  ANYNET_IF_AVX512(namespace avx512 {                                             \
    template <class T>                                                            \
    void name(const Args<T>& args, int threads);                                  \
  })                                                                              \
  template <class T>                                                              \
  void name(Isa isa, const Args<T>& args, int threads) {                          \
    switch (isa) {                                                                \
      ANYNET_IF_AVX512(case Isa::avx512 : return avx512::name<T>(args, threads);) \
      ANYNET_IF_AVX2(case Isa::avx2 : return avx2::name<T>(args, threads);)       \
      default:                                                                    \
        return baseline::name<T>(args, threads);                                  \
    }                                                                             \
  }

/// Defines the variants of this translation unit for all element types.
#define ANYNET_INSTANTIATE_KERNEL(name, Args)             \
  template void name<float>(const Args<float>&, int);     \
  template void name<double>(const Args<double>&, int);   \
  template void name<float16>(const Args<float16>&, int); \
  template void name<bfloat16>(const Args<bfloat16>&, int);
