// How many threads the CPU kernels use.
#include <pthread.h>

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
/// Threads that each own a team of more threads than there are processors, all asleep, until they are to end. By
/// pthread, whose functions, unlike semaphores and C++'s condition variables, have been in every glibc under the same
/// version.
class Crowd {
 public:
  void begin() {
    std::thread([this] {
#pragma omp parallel num_threads(omp_get_num_procs() + 1)
      asm volatile("");  // or there would be no team
      pthread_mutex_lock(&mutex_);
      while (to_end_ == 0) pthread_cond_wait(&changed_, &mutex_);
      --to_end_;
      pthread_mutex_unlock(&mutex_);
    }).detach();
  }

  void end() {
    pthread_mutex_lock(&mutex_);
    ++to_end_;
    pthread_cond_signal(&changed_);
    pthread_mutex_unlock(&mutex_);
  }

 private:
  pthread_mutex_t mutex_ = PTHREAD_MUTEX_INITIALIZER;
  pthread_cond_t changed_ = PTHREAD_COND_INITIALIZER;
  int to_end_ = 0;
};

Crowd crowd;
#endif

}  // namespace

int num_threads() { return forked ? 1 : static_cast<int>(torch::stable::get_num_threads()); }

}  // namespace anynet::ops

/// See anynet_ext._library. GCC's OpenMP has no function for it, but it lets waiting threads spin for no more than 100
/// rounds, instead of 300,000, where the process has more of its threads than there are processors. 0 if they wait as
/// the environment says.
extern "C" __attribute__((visibility("default"))) int anynet_begin_waiting_passively() {
#ifdef _OPENMP
  if (std::getenv("OMP_WAIT_POLICY") != nullptr || std::getenv("GOMP_SPINCOUNT") != nullptr) return 0;
  try {
    anynet::ops::crowd.begin();
    return 1;
  } catch (const std::system_error&) {  // no more threads: these go on spinning
  }
#endif
  return 0;
}

/// As often as that gave 1.
extern "C" __attribute__((visibility("default"))) void anynet_end_waiting_passively() {
#ifdef _OPENMP
  anynet::ops::crowd.end();
#endif
}
