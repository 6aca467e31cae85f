// std::vector for files that are compiled per instruction set.
#pragma once

#include <cstdlib>
#include <new>
#include <vector>

#include "memory.h"

namespace anynet::ANYNET_ISA {

/// Gives std::vector's functions, compiled for one instruction set, names of their own, so that the linker cannot merge
/// them with those of another set or of the program. And elements without a value begin uninitialized.
template <class T>
struct Allocator {
  using value_type = T;
  Allocator() = default;
  template <class U>
  Allocator(const Allocator<U>&) {}
  T* allocate(std::size_t count) {
    void* p = std::malloc(count * sizeof(T));
    if (p == nullptr) throw_out_of_memory();
    return static_cast<T*>(p);
  }
  void deallocate(T* p, std::size_t) { std::free(p); }
  template <class U>
  void construct(U* p) {
    ::new (static_cast<void*>(p)) U;
  }
  template <class U, class V>
  void construct(U* p, const V& value) {
    ::new (static_cast<void*>(p)) U(value);
  }
  friend bool operator==(const Allocator&, const Allocator&) { return true; }
  friend bool operator!=(const Allocator&, const Allocator&) { return false; }
};

template <class T>
using Vector = std::vector<T, Allocator<T>>;

}  // namespace anynet::ANYNET_ISA
