#define ANYNET_ISA baseline
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <new>
#include <thread>
#include <vector>

#include "../../csrc/kernels/common/parallel.h"

using namespace anynet::baseline;

void expect(bool right, const char* what, int64_t count, int threads) {
  if (right) return;
  std::printf("%s, %lld indices on %d threads\n", what, static_cast<long long>(count), threads);
  std::exit(1);
}

int main() {
  for (int threads = 1; threads <= 5; ++threads) {
    for (int64_t count = 0; count < 100; ++count) {
      std::vector<std::atomic<int>> seen(count);
      parallel_ranges(count, threads, [&](int64_t begin, int64_t end) {
        expect(begin < end, "an empty part", count, threads);
        for (int64_t i = begin; i < end; ++i) ++seen[i];
      });
      for (const auto& times : seen) expect(times == 1, "an index not computed once", count, threads);
    }
    bool thrown = false;
    try {
      parallel_for(40, threads, [&](int64_t i) {
        if (i == 27) throw std::bad_alloc();
      });
    } catch (const std::bad_alloc&) {
      thrown = true;
    }
    expect(thrown, "an exception that got lost", 40, threads);
  }

#if defined(_OPENMP) || defined(ANYNET_STD_THREADS)
  constexpr int threads = 2;
  std::thread::id by[64];
  const auto record = [&](int64_t i) { by[i] = std::this_thread::get_id(); };
  parallel_for(threads, threads, record);
  expect(by[0] != by[1], "two indices on one thread", threads, threads);

  // Whoever computes index 0 is slow, and is spared all but half of its share and the part that it is in.
  parallel_for(64, threads, [&](int64_t i) {
    record(i);
    if (i == 0) std::this_thread::sleep_for(std::chrono::milliseconds(300));
  });
  int slow = 0;
  for (const auto& id : by) slow += id == by[0];
  expect(slow <= 16 + 4, "a slow thread that the others wait for", 64, threads);
#endif
}
