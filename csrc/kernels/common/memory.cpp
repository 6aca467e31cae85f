#include "memory.h"

#include <cstdlib>
#include <new>

namespace anynet {
namespace {

class OutOfMemory : public std::bad_alloc {
 public:
  const char* what() const noexcept override { return "expected enough memory for the operator's scratch, got none"; }
};

}  // namespace

void throw_out_of_memory() { throw OutOfMemory(); }

void* allocate_scratch(int64_t count, int64_t size) {
  int64_t bytes;
  if (count < 0 || size < 0 || __builtin_mul_overflow(count, size, &bytes) || bytes > INT64_MAX - 64) {
    throw_out_of_memory();
  }
  void* memory = std::aligned_alloc(64, static_cast<std::size_t>(bytes / 64 + 1) * 64);
  if (memory == nullptr) throw_out_of_memory();
  return memory;
}

void free_scratch(void* memory) noexcept { std::free(memory); }

}  // namespace anynet
