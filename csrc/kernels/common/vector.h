// std::vector for files that are compiled per instruction set.
#pragma once

#include <cstdlib>
#include <new>
#include <vector>

namespace anynet::ANYNET_ISA {

/// Its only purpose is its name: std::vector's functions, compiled for one instruction set, get names of their own, so
/// that the linker cannot merge them with those of another set or of the program.
template <class T>
struct Allocator {
  using value_type = T;
  Allocator() = default;
  template <class U>
  Allocator(const Allocator<U>&) {}
  T* allocate(std::size_t count) {
    void* p = std::malloc(count * sizeof(T));
    if (p == nullptr) throw std::bad_alloc();
    return static_cast<T*>(p);
  }
  void deallocate(T* p, std::size_t) { std::free(p); }
  friend bool operator==(const Allocator&, const Allocator&) { return true; }
  friend bool operator!=(const Allocator&, const Allocator&) { return false; }
};

template <class T>
using Vector = std::vector<T, Allocator<T>>;

}  // namespace anynet::ANYNET_ISA
