// Working memory of one thread. Included by files that are compiled per instruction set.
#pragma once

#include <cstdint>
#include <cstdlib>

namespace anynet::ANYNET_ISA {

/// Uninitialised memory for `count` elements, aligned to a cache line, freed at the end of the scope.
template <class A>
class Scratch {
 public:
  explicit Scratch(int64_t count) : data_(static_cast<A*>(std::aligned_alloc(64, (count * sizeof(A) / 64 + 1) * 64))) {
    if (data_ == nullptr) std::abort();  // inside a parallel region: nothing to throw to
  }
  ~Scratch() { std::free(data_); }
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
