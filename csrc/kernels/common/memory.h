// Memory for the kernels' scratch, or an exception.
#pragma once

#include <cstdint>

namespace anynet {

/// count * size bytes, aligned to a cache line. Throws a std::bad_alloc that says so if there are none, or if the
/// product does not fit.
void* allocate_scratch(int64_t count, int64_t size);
void free_scratch(void* memory) noexcept;

/// The same exception, for threads that cannot throw it themselves.
[[noreturn]] void throw_out_of_memory();

}  // namespace anynet
