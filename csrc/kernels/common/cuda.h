// What the CUDA kernels share: element types on the device, 16-byte packs, shared memory, launches.
// Included by *_cuda.cu only. nvcc compiles those files for GPUs; the tests compile the same files with g++ for the
// CPU, where tests/cuda/emulator/cuda_runtime.h stands in for NVIDIA's.
#pragma once

#include <cuda_runtime.h>

#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>

#include "affine_relu.h"
#include "half.h"
#include "isa.h"
#include "tensor.h"

namespace anynet::cuda {

#define ANYNET_DEVICE __device__ __forceinline__

constexpr unsigned all_lanes = 0xffffffffu;  // of a warp

// ------------------------------------------------------------------------------------------------- element types
ANYNET_DEVICE float to_accumulator(float a) { return a; }
ANYNET_DEVICE double to_accumulator(double a) { return a; }
ANYNET_DEVICE float to_accumulator(bfloat16 a) { return __uint_as_float(static_cast<unsigned>(a.bits) << 16); }
ANYNET_DEVICE float to_accumulator(float16 a) {
#ifdef __CUDACC__
  float f;
  asm("cvt.f32.f16 %0, %1;" : "=f"(f) : "h"(a.bits));
  return f;
#else
  return to_float(a);
#endif
}

/// Rounds to nearest even, as PyTorch does.
template <class T>
ANYNET_DEVICE T from_accumulator(accumulator_t<T> a) {
  return a;
}
template <>
ANYNET_DEVICE bfloat16 from_accumulator<bfloat16>(float a) {
  if (a != a) return bfloat16{0x7fc0};
  const unsigned bits = __float_as_uint(a);
  return bfloat16{static_cast<uint16_t>((bits + 0x7fff + ((bits >> 16) & 1)) >> 16)};
}
template <>
ANYNET_DEVICE float16 from_accumulator<float16>(float a) {
#ifdef __CUDACC__
  float16 h;
  asm("cvt.rn.f16.f32 %0, %1;" : "=h"(h.bits) : "f"(a));
  return h;
#else
  return to_float16(a);
#endif
}

// ------------------------------------------------------------------------------------------------- global memory
/// One element of an input that no thread of this launch writes (so loads may pass stores).
ANYNET_DEVICE float read_raw(const float* p) { return __ldg(p); }
ANYNET_DEVICE double read_raw(const double* p) { return __ldg(p); }
ANYNET_DEVICE float16 read_raw(const float16* p) { return {__ldg(reinterpret_cast<const unsigned short*>(p))}; }
ANYNET_DEVICE bfloat16 read_raw(const bfloat16* p) { return {__ldg(reinterpret_cast<const unsigned short*>(p))}; }

/// The same, ready to compute with.
template <class T>
ANYNET_DEVICE accumulator_t<T> read(const T* p) {
  return to_accumulator(read_raw(p));
}

/// N consecutive elements moved at once; pointers to it are aligned to its size, 16 bytes at most.
template <class T, int N>
struct alignas(sizeof(T) * N) Pack {
  T value[N];
};

template <int Bytes>
struct Word;
template <>
struct Word<16> {
  using type = uint4;
};
template <>
struct Word<8> {
  using type = uint2;
};
template <>
struct Word<4> {
  using type = unsigned;
};
template <>
struct Word<2> {
  using type = unsigned short;
};

template <class T, int N>
ANYNET_DEVICE Pack<T, N> read_pack(const T* p) {
  using W = typename Word<sizeof(T) * N>::type;
  const W word = __ldg(reinterpret_cast<const W*>(p));
  Pack<T, N> pack;
  memcpy(&pack, &word, sizeof(pack));
  return pack;
}

template <class T, int N>
ANYNET_DEVICE void write_pack(T* p, const Pack<T, N>& pack) {
  typename Word<sizeof(T) * N>::type word;
  memcpy(&word, &pack, sizeof(word));
  __stwb(reinterpret_cast<decltype(word)*>(p), word);  // an assignment may become four narrower stores (sm_75)
}

/// Elements of T in 16 bytes.
template <class T>
constexpr int wide = 16 / sizeof(T);

inline bool aligned(const void* p) { return reinterpret_cast<uintptr_t>(p) % 16 == 0; }

/// Whether every row of `v` starts at a multiple of 16 bytes and has unit stride (dimensions of size 1 do not matter).
template <class T, int Rank>
bool rows_aligned(const View<T, Rank>& v) {
  if (!aligned(v.data) || (v.size[Rank - 1] > 1 && v.stride[Rank - 1] != 1)) return false;
  for (int i = 0; i + 1 < Rank; ++i) {
    if (v.size[i] > 1 && v.stride[i] % wide<T> != 0) return false;
  }
  return true;
}

/// Copies N elements from shared memory into registers, 16 bytes at a time; `from` is aligned to 16 bytes.
template <class T, int N>
ANYNET_DEVICE void copy_wide(const T* from, T (&to)[N]) {
  if constexpr (N % wide<T> == 0) {
#pragma unroll
    for (int i = 0; i < N; i += wide<T>) {
      const Pack<T, wide<T>> pack = *reinterpret_cast<const Pack<T, wide<T>>*>(from + i);
#pragma unroll
      for (int j = 0; j < wide<T>; ++j) to[i + j] = pack.value[j];
    }
  } else {
#pragma unroll
    for (int i = 0; i < N; ++i) to[i] = from[i];
  }
}

// ---------------------------------------------------------------------------------------------------- arithmetic
/// max(0, a); NaN stays NaN.
template <class A>
ANYNET_DEVICE A relu(A a) {
  return a < 0 ? 0 : a;
}

/// The epilogue of a value of that plane, if there is one.
template <class T>
ANYNET_DEVICE accumulator_t<T> apply(const AffineRelu<T>& epilogue, int64_t plane, accumulator_t<T> value) {
  if (epilogue.scale == nullptr) return value;
  const int64_t c = plane % epilogue.channels;
  return relu(read(epilogue.scale + c) * value + read(epilogue.shift + c));
}

/// A position on an axis of `size` elements, clamped to it: (1 - fraction) of `low` and `fraction` of `high`.
struct LinearPosition {
  int64_t low, high;
  float fraction;

  ANYNET_DEVICE LinearPosition(float p, int64_t size) {
    low = static_cast<int64_t>(p > 0 ? p : 0);
    low = low < size - 1 ? low : size - 1;
    high = low + 1 < size ? low + 1 : low;
    fraction = p - static_cast<float>(low);
    fraction = fraction < 0 ? 0 : fraction > 1 ? 1 : fraction;
  }

  /// Of element i of an axis that is `ratio` times longer, align_corners=False.
  ANYNET_DEVICE static LinearPosition half_pixel(int64_t i, float ratio, int64_t size) {
    return {(static_cast<float>(i) + 0.5f) / ratio - 0.5f, size};
  }
  /// Of element i of an axis of `out_size`, align_corners=True.
  ANYNET_DEVICE static LinearPosition corners(int64_t i, int64_t out_size, int64_t size) {
    return {out_size > 1 ? static_cast<float>(i * (size - 1)) / static_cast<float>(out_size - 1) : 0.f, size};
  }

  ANYNET_DEVICE float between(float at_low, float at_high) const { return at_low + fraction * (at_high - at_low); }
};

/// The map [., width] at a position.
ANYNET_DEVICE float bilinear(const float* map, int64_t width, const LinearPosition& y, const LinearPosition& x) {
  const float *upper = map + y.low * width, *lower = map + y.high * width;
  return x.between(y.between(read(upper + x.low), read(lower + x.low)),
                   y.between(read(upper + x.high), read(lower + x.high)));
}

// -------------------------------------------------------------------------------------------------- one thread a pixel
/// A thread's pixel where a launch has `Pixel::blocks(rows, width)` blocks of `Pixel::threads` threads: a warp has 32
/// neighbors of one row.
struct Pixel {
  static constexpr int rows_per_block = 4;
  static constexpr int threads_per_block = 32 * rows_per_block;
  int64_t row, x;

  ANYNET_DEVICE explicit Pixel(int64_t width) {
    const unsigned tiles = static_cast<unsigned>((width + 31) / 32);
    row = static_cast<int64_t>(blockIdx.x / tiles) * rows_per_block + threadIdx.y;
    x = blockIdx.x % tiles * 32 + threadIdx.x;
  }

  static dim3 threads() { return {32, rows_per_block}; }
  static int64_t blocks(int64_t rows, int64_t width) {
    return (rows + rows_per_block - 1) / rows_per_block * ((width + 31) / 32);
  }
};

// ------------------------------------------------------------------------------------------------- shared memory
/// Hands out the block's dynamic shared memory, array after array; every thread must take the same arrays in order.
/// (The emulator allocates each array by itself, so that AddressSanitizer sees where one ends.)
class SharedMemory {
 public:
  template <class T>
  ANYNET_DEVICE T* take(int count) {
#ifdef __CUDACC__
    extern __shared__ uint4 anynet_shared_memory[];
    T* array = reinterpret_cast<T*>(reinterpret_cast<char*>(anynet_shared_memory) + used_);
    used_ += (count * static_cast<int>(sizeof(T)) + 15) / 16 * 16;
    return array;
#else
    return static_cast<T*>(emulator::shared_array(used_++, count * sizeof(T)));
#endif
  }

 private:
  int used_ = 0;
};

/// Bytes that take<T>(count) uses.
template <class T>
constexpr int64_t shared_bytes(int64_t count) {
  return (count * static_cast<int64_t>(sizeof(T)) + 15) / 16 * 16;
}

// ------------------------------------------------------------------------------------------------------ launches
inline void check(cudaError_t error, const char* what) {
  if (error != cudaSuccess) throw std::runtime_error(std::string(what) + ": CUDA error: " + cudaGetErrorString(error));
}

inline int64_t ceil_div(int64_t a, int64_t b) { return (a + b - 1) / b; }

/// Starts `kernel` with `blocks` blocks (none: nothing happens) on the stream. Only queues work: fit for graph capture.
template <class... Parameters, class... Arguments>
void launch(const char* name, void (*kernel)(Parameters...), int64_t blocks, dim3 threads, int64_t shared,
            [[maybe_unused]] Stream stream, const Arguments&... arguments) {
  if (blocks == 0) return;
  if (blocks > 0x7fffffff) throw std::runtime_error(std::string(name) + ": the tensor is too large for one CUDA grid");
  const unsigned grid = static_cast<unsigned>(blocks);
#ifdef __CUDACC__
  if (shared > 48 * 1024) {  // more has to be asked for, and depends on the device
    const cudaError_t error =
        cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, static_cast<int>(shared));
    if (error != cudaSuccess) {
      cudaGetLastError();  // not sticky: leave no trace of it
      throw std::runtime_error(std::string(name) + ": needs " + std::to_string(shared) +
                               " bytes of shared memory per block, more than this GPU has");
    }
  }
  kernel<<<grid, threads, static_cast<size_t>(shared), static_cast<cudaStream_t>(stream)>>>(arguments...);
#else
  emulator::run(grid, threads, shared, [&] { kernel(arguments...); });
#endif
  check(cudaGetLastError(), name);
}

/// Defines the functions that ANYNET_DECLARE_KERNEL (isa.h) declares, for all element types.
#define ANYNET_INSTANTIATE_CUDA_KERNEL(name, Args)           \
  template void name<float>(const Args<float>&, Stream);     \
  template void name<double>(const Args<double>&, Stream);   \
  template void name<float16>(const Args<float16>&, Stream); \
  template void name<bfloat16>(const Args<bfloat16>&, Stream);

}  // namespace anynet::cuda
