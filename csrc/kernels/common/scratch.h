// Working memory of one thread. Included by files that are compiled per instruction set.
#pragma once

#include "memory.h"

namespace anynet::ANYNET_ISA {

/// Uninitialized memory for count * size elements, aligned to a cache line, freed at the end of the scope.
template <class A>
class Scratch {
 public:
  explicit Scratch(int64_t count, int64_t size = 1)
      : data_(static_cast<A*>(allocate_scratch(count, size * int64_t{sizeof(A)}))) {}
  ~Scratch() { free_scratch(data_); }
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;
  operator A*() const { return data_; }

 private:
  A* data_;
};

template <class A>
inline void fill_zero(A* p, int64_t count) {
  for (int64_t i = 0; i < count; ++i) p[i] = 0;
}

}  // namespace anynet::ANYNET_ISA
