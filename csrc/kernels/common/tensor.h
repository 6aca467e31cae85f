// What a kernel is told about a tensor: pointer, sizes, strides. No framework here.
#pragma once

#include <cstdint>

namespace anynet {

/// A strided array. `data` points at element 0; strides count elements and may be 0 (expanded) or negative.
template <class T, int Rank>
struct View {
  T* data;
  int64_t size[Rank];
  int64_t stride[Rank];
};

template <class T>
using View4 = View<T, 4>;

/// Element types without arithmetic of their own: kernels read them into float, compute there, and round once.
struct float16 {
  uint16_t bits;
};
struct bfloat16 {
  uint16_t bits;
};

/// The type a kernel computes and accumulates in.
template <class T>
struct Accumulator {
  using type = T;
};
template <>
struct Accumulator<float16> {
  using type = float;
};
template <>
struct Accumulator<bfloat16> {
  using type = float;
};
template <class T>
using accumulator_t = typename Accumulator<T>::type;

}  // namespace anynet
