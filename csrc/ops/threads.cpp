// How many threads the CPU kernels use.
#include <pthread.h>
#include <unistd.h>

#include <cstdlib>
#include <system_error>
#include <thread>

#ifdef _OPENMP
#include <omp.h>
#endif

#include "tensor.h"

namespace anynet::ops {
namespace {

bool forked = false;

// libgomp's threads do not survive a fork, and the child would wait for them for ever.
[[maybe_unused]] const int registered = pthread_atfork(nullptr, nullptr, [] { forked = true; });

#ifdef _OPENMP
/// Owns a team of more threads than there are processors, all asleep.
void sleep_for_ever() {
#pragma omp parallel num_threads(omp_get_num_procs() + 1)
  asm volatile("");  // or there would be no team
  for (;;) pause();
}
#endif

}  // namespace

int num_threads() { return forked ? 1 : static_cast<int>(torch::stable::get_num_threads()); }

}  // namespace anynet::ops

/// See anynet_ext._library. GCC's OpenMP has no function for it, but it lets waiting threads spin for no more than 100
/// rounds, instead of 300,000, where the process has more of its threads than there are processors.
extern "C" __attribute__((visibility("default"))) void anynet_wait_passively() {
#ifdef _OPENMP
  if (std::getenv("OMP_WAIT_POLICY") != nullptr || std::getenv("GOMP_SPINCOUNT") != nullptr) return;
  try {
    std::thread(anynet::ops::sleep_for_ever).detach();
  } catch (const std::system_error&) {  // no more threads: these go on spinning
  }
#endif
}
