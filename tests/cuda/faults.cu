// Kernels with one deliberate fault each, to see that the emulator and the sanitizers catch it: `faults NAME`.
#include <cstdio>
#include <cstring>
#include <vector>

#include "../../csrc/kernels/common/cuda.h"

using namespace anynet::cuda;

namespace {

enum class Fault { none, shared_overrun, global_overrun, missing_barrier, plain_add, divergent_barrier, misaligned };
constexpr const char* names[] = {"none",      "shared_overrun",    "global_overrun", "missing_barrier",
                                 "plain_add", "divergent_barrier", "misaligned"};
constexpr int threads = 64;

/// Reverses `in` through shared memory and counts the elements.
__global__ void reverse(const float* in, float* out, int* count, Fault fault) {
  const int i = threadIdx.x;
  SharedMemory shared;
  float* line = shared.take<float>(threads);
  shared.take<float>(threads);  // no overrun may hide in what follows
  line[fault == Fault::shared_overrun ? i + 1 : i] = read(in + i);
  if (fault != Fault::missing_barrier && (fault != Fault::divergent_barrier || i < 32)) __syncthreads();
  out[fault == Fault::global_overrun ? i + 1 : i] = line[threads - 1 - i];
  if (fault == Fault::plain_add || i == 0) *count += 1;
  if (fault == Fault::misaligned && i == 1) write_pack(out + i, read_pack<float, 4>(in + i));
}

}  // namespace

int main(int argc, char** argv) {
  for (int f = 0; argc > 1 && f < 7; ++f) {
    if (std::strcmp(argv[1], names[f]) != 0) continue;
    std::vector<float> in(threads), out(threads);
    std::vector<int> count(1);
    try {
      launch(argv[1], reverse, 1, threads, 2 * shared_bytes<float>(threads), nullptr, in.data(), out.data(),
             count.data(), static_cast<Fault>(f));
    } catch (const std::exception& error) {
      std::fprintf(stderr, "%s\n", error.what());
      return 1;
    }
    return 0;
  }
  std::fprintf(stderr, "usage: faults NAME\n");
  return 2;
}
