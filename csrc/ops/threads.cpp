// How many threads the CPU kernels use.
#include <pthread.h>

#include "tensor.h"

namespace anynet::ops {
namespace {

bool forked = false;

// libgomp's threads do not survive a fork, and the child would wait for them for ever.
[[maybe_unused]] const int registered = pthread_atfork(nullptr, nullptr, [] { forked = true; });

}  // namespace

int num_threads() { return forked ? 1 : static_cast<int>(torch::stable::get_num_threads()); }

}  // namespace anynet::ops
