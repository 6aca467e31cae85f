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

/// Calls body(begin, end) with parts of [0, count) that up to `threads` threads share. A kernel must compute each
/// index in the same way whichever part it falls into, so that results do not depend on the number of threads.
/// `body` may throw std::bad_alloc, and nothing else.
///
/// Cores are not equally fast: some are small, some are lent to other work meanwhile. So each thread begins with half
/// of its share, whose neighbors it has in its cache, and the rest goes to whoever is free, in parts that become
/// smaller: the last ones are all that a thread waits for. Half of one index is that index: with as many indices as
/// threads, each thread has its own.
template <class Body>
void parallel_ranges(int64_t count, int threads, const Body& body) {
  if (threads > count) threads = static_cast<int>(count);
  if (threads <= 1) {
    if (count > 0) body(int64_t{0}, count);
    return;
  }
  constexpr int parts = 9;  // of a share
  bool failed = false;      // an exception may not leave the thread that threw it
  int next = 0;
  const auto compute = [&](int64_t begin, int64_t end) {
    if (begin == end) return;
    try {
      body(begin, end);
    } catch (const std::bad_alloc&) {
      __atomic_store_n(&failed, true, __ATOMIC_RELAXED);
    }
  };
  const auto compute_part = [&](int share, int part) {
    const int64_t end = count * (share + 1) / threads, size = end - count * share / threads;
    const auto left = [&](int i) { return i < parts ? size >> i : 0; };  // before part i
    compute(end - left(part), end - left(part + 1));
  };
  const auto work = [&](int t) {
    compute_part(t, 0);
    for (int i; (i = __atomic_fetch_add(&next, 1, __ATOMIC_RELAXED)) < (parts - 1) * threads;) {
      compute_part(i % threads, 1 + i / threads);
    }
  };
#ifdef ANYNET_STD_THREADS  // ThreadSanitizer does not understand libgomp's barriers
  std::vector<std::thread> pool;
  for (int t = 0; t < threads; ++t) pool.emplace_back(work, t);
  for (auto& thread : pool) thread.join();
#else
#pragma omp parallel for num_threads(threads) schedule(static)
  for (int t = 0; t < threads; ++t) work(t);
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
