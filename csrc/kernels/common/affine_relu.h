// The epilogue that kernels of the deployed network share: a folded batch norm and a ReLU on the way to memory.
#pragma once

#include <cstdint>

namespace anynet {

/// out = max(0, scale[c] * value + shift[c]), where c is the value's channel: its plane modulo `channels`. NaN stays
/// NaN. A kernel that has this field applies it, or refuses to run if it is set.
template <class T>
struct AffineRelu {
  const T* scale = nullptr;  // [channels]; nullptr: no epilogue, out = value
  const T* shift = nullptr;  // [channels]
  int64_t channels = 1;
};

}  // namespace anynet
