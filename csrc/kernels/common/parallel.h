// Threads for CPU kernels. Included by files that are compiled per instruction set.
#pragma once

#include <cstdint>

#ifdef ANYNET_STD_THREADS
#include <thread>
#include <vector>
#endif

namespace anynet::ANYNET_ISA {

/// Calls body(begin, end) with the parts of [0, count) that up to `threads` threads share. A kernel must compute each
/// index in the same way whichever part it falls into, so that results do not depend on the number of threads.
/// `body` must not throw.
template <class Body>
void parallel_ranges(int64_t count, int threads, const Body& body) {
  if (threads > count) threads = static_cast<int>(count);
  if (threads <= 1) {
    if (count > 0) body(int64_t{0}, count);
    return;
  }
#ifdef ANYNET_STD_THREADS  // ThreadSanitizer does not understand libgomp's barriers
  std::vector<std::thread> pool;
  for (int t = 0; t < threads; ++t) {
    pool.emplace_back([=, &body] { body(count * t / threads, count * (t + 1) / threads); });
  }
  for (auto& thread : pool) thread.join();
#else
#pragma omp parallel for num_threads(threads) schedule(static)
  for (int t = 0; t < threads; ++t) body(count * t / threads, count * (t + 1) / threads);
#endif
}

/// Calls body(i) for i in [0, count), each index wholly on one of up to `threads` threads.
template <class Body>
void parallel_for(int64_t count, int threads, const Body& body) {
  parallel_ranges(count, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) body(i);
  });
}

/// How many of `threads` threads are worth waking for `work` elementary operations.
inline int useful_threads(int64_t work, int threads) {
  constexpr int64_t worth_a_thread = 100000;
  const int64_t useful = work / worth_a_thread;
  return useful < threads ? static_cast<int>(useful) : threads;
}

}  // namespace anynet::ANYNET_ISA
