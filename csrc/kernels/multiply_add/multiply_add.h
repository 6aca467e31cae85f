// Nothing but multiply-adds, in registers and independent of each other: how many a machine can do, which is the limit
// that the benchmarks measure kernels by.
#pragma once

#include "../common/isa.h"

namespace anynet {

template <class T>
struct MultiplyAdd {
  int64_t rounds;
  T factor, other;
  T* out;          // [threads]: the sum of numbers each of which was 0, and grew `rounds` times by factor * other
  int64_t* count;  // multiply-adds done
};

ANYNET_DECLARE_KERNEL(multiply_add, MultiplyAdd)

}  // namespace anynet
