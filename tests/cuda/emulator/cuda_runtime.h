// Stands in for NVIDIA's cuda_runtime.h when g++ compiles our .cu files: CUDA on one CPU thread.
//
// Each CUDA thread is a fiber. Blocks run one after another; inside a block the fibers run in turn, from one barrier to
// the next, in an order that changes at every turn. Only what our kernels use is here. Shared memory is dynamic
// (SharedMemory in csrc/kernels/common/cuda.h); each array is an allocation of its own, so AddressSanitizer guards its
// ends. ThreadSanitizer sees every fiber as a thread that only barriers synchronize, so it reports a missing barrier or
// two threads that update one address, whatever order they happened to run in.
//
// What it cannot show: warps in lockstep, the GPU's memory model, speed.
#pragma once

#include <math.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>

#define __global__
#define __device__
#define __host__
#define __forceinline__ inline __attribute__((always_inline))
#define __launch_bounds__(...)

struct dim3 {
  unsigned x, y, z;
  constexpr dim3(unsigned x = 1, unsigned y = 1, unsigned z = 1) : x(x), y(y), z(z) {}
};

struct alignas(8) uint2 {
  unsigned x, y;
};
struct alignas(16) uint4 {
  unsigned x, y, z, w;
};

namespace emulator {

dim3 thread_index();
dim3 block_index();
dim3 block_size();

/// Runs `thread` as every thread of every block. Throws std::runtime_error if the threads of a block wait at different
/// barriers, or if the kernel takes more shared memory than `shared_bytes`.
void run(dim3 grid, dim3 block, size_t shared_bytes, const std::function<void()>& thread);

/// How many kernels have run.
int64_t launches();

/// The block's array number `index`, allocated when the first thread asks for it.
void* shared_array(int index, size_t bytes);

void block_barrier();

/// Puts `bytes` of every lane of the calling warp into `all`, lane after lane; all its threads must call it.
void exchange(const void* mine, size_t bytes, void* all);

}  // namespace emulator

#define threadIdx (::emulator::thread_index())
#define blockIdx (::emulator::block_index())
#define blockDim (::emulator::block_size())

inline void __syncthreads() { ::emulator::block_barrier(); }

inline unsigned __ballot_sync(unsigned, int predicate) {
  int all[32];
  ::emulator::exchange(&predicate, sizeof(int), all);
  unsigned mask = 0;
  for (int lane = 0; lane < 32; ++lane) mask |= (all[lane] != 0 ? 1u : 0u) << lane;
  return mask;
}

template <class T>
T __shfl_sync(unsigned, T value, int lane) {
  T all[32];
  ::emulator::exchange(&value, sizeof(T), all);
  return all[lane & 31];
}

inline int __ffs(int bits) { return __builtin_ffs(bits); }

template <class T>
T __ldg(const T* p) {
  return *p;
}
template <class T>
void __stwb(T* p, T value) {
  *p = value;
}

inline float __uint_as_float(unsigned bits) {
  float f;
  memcpy(&f, &bits, sizeof(f));
  return f;
}
inline unsigned __float_as_uint(float f) {
  unsigned bits;
  memcpy(&bits, &f, sizeof(bits));
  return bits;
}

// Host side.
using cudaStream_t = void*;
using cudaError_t = int;
constexpr cudaError_t cudaSuccess = 0;
inline cudaError_t cudaGetLastError() { return cudaSuccess; }
inline const char* cudaGetErrorString(cudaError_t) { return "no error"; }

enum cudaMemcpyKind { cudaMemcpyHostToDevice, cudaMemcpyDeviceToHost };
inline cudaError_t cudaMalloc(void** p, size_t bytes) {
  *p = malloc(bytes);
  return cudaSuccess;
}
inline cudaError_t cudaMemcpy(void* to, const void* from, size_t bytes, cudaMemcpyKind) {
  memcpy(to, from, bytes);
  return cudaSuccess;
}
inline cudaError_t cudaFree(void* p) {
  free(p);
  return cudaSuccess;
}
