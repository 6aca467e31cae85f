#include "../../csrc/kernels/multiply_add/multiply_add.h"
#include "check.h"

using namespace anynet;

int main() {
  for (Isa isa : {Isa::baseline, Isa::avx2, Isa::avx512}) {
    if (!isa_available(isa)) continue;
    for (int threads : {1, 3}) {
      std::vector<float> out(threads);
      int64_t count = 0;
      multiply_add(isa, MultiplyAdd<float>{5, 2, 3, out.data(), &count}, threads);
      const double each = static_cast<double>(count) / threads;
      check::near("multiply_add", out, std::vector<double>(threads, 6 * each));
      if (each < 5 * 4) std::exit(1);
    }
  }
}
