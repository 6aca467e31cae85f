// Threads for CPU kernels. Included by files that are compiled per instruction set.
#pragma once

#include <cstdint>

#ifdef ANYNET_STD_THREADS
#include <thread>
#include <vector>
#endif

namespace anynet::ANYNET_ISA {

/// Calls body(i) for i in [0, count) on up to `threads` threads. Each index runs once, wholly on one thread, so
/// results do not depend on the number of threads. `body` must not throw.
template <class Body>
void parallel_for(int64_t count, int threads, const Body& body) {
  if (threads > count) threads = static_cast<int>(count);
  if (threads <= 1) {
    for (int64_t i = 0; i < count; ++i) body(i);
    return;
  }
#ifdef ANYNET_STD_THREADS  // ThreadSanitizer does not understand libgomp's barriers
  std::vector<std::thread> pool;
  for (int t = 0; t < threads; ++t) {
    pool.emplace_back([=, &body] {
      for (int64_t i = count * t / threads; i < count * (t + 1) / threads; ++i) body(i);
    });
  }
  for (auto& thread : pool) thread.join();
#else
#pragma omp parallel for num_threads(threads) schedule(static)
  for (int64_t i = 0; i < count; ++i) body(i);
#endif
}

}  // namespace anynet::ANYNET_ISA
