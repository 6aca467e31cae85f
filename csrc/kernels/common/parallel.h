// Threads for CPU kernels. Included by files that are compiled per instruction set.
#pragma once

#include <cstdint>
#include <new>

#include "memory.h"

#ifdef ANYNET_STD_THREADS
#include <thread>
#include <vector>
#endif

namespace anynet::ANYNET_ISA {

/// Calls body(begin, end) with the parts of [0, count) that up to `threads` threads share. A kernel must compute each
/// index in the same way whichever part it falls into, so that results do not depend on the number of threads.
/// `body` may throw std::bad_alloc, and nothing else.
template <class Body>
void parallel_ranges(int64_t count, int threads, const Body& body) {
  if (threads > count) threads = static_cast<int>(count);
  if (threads <= 1) {
    if (count > 0) body(int64_t{0}, count);
    return;
  }
  bool failed = false;  // an exception may not leave the thread that threw it
  const auto part = [&](int t) {
    try {
      body(count * t / threads, count * (t + 1) / threads);
    } catch (const std::bad_alloc&) {
      __atomic_store_n(&failed, true, __ATOMIC_RELAXED);
    }
  };
#ifdef ANYNET_STD_THREADS  // ThreadSanitizer does not understand libgomp's barriers
  std::vector<std::thread> pool;
  for (int t = 0; t < threads; ++t) pool.emplace_back(part, t);
  for (auto& thread : pool) thread.join();
#else
#pragma omp parallel for num_threads(threads) schedule(static)
  for (int t = 0; t < threads; ++t) part(t);
#endif
  if (failed) throw_out_of_memory();
}

/// Calls body(i) for i in [0, count), each index wholly on one of up to `threads` threads.
template <class Body>
void parallel_for(int64_t count, int threads, const Body& body) {
  parallel_ranges(count, threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) body(i);
  });
}

/// How many of `threads` threads are worth waking for so many elementary operations: the product of `work`.
template <class... Factors>
int useful_threads(int threads, Factors... work) {
  constexpr double worth_a_thread = 100000;
  const double useful = (static_cast<double>(work) * ...) / worth_a_thread;  // no integer could overflow
  return useful < threads ? static_cast<int>(useful) : threads;
}

}  // namespace anynet::ANYNET_ISA
