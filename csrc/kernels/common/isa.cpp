#include "isa.h"

#include <cstdlib>
#include <stdexcept>
#include <string>

namespace anynet {

namespace {

constexpr Isa best_first[] = {Isa::avx512, Isa::avx2, Isa::baseline};

Isa choose() {
  const char* forced = std::getenv("ANYNET_ISA");
  if (forced == nullptr || *forced == '\0') {
    for (Isa isa : best_first) {
      if (isa_available(isa)) return isa;
    }
  }
  std::string available;
  for (Isa isa : best_first) {
    if (!isa_available(isa)) continue;
    if (std::string(forced) == isa_name(isa)) return isa;
    available += std::string(available.empty() ? "" : ", ") + isa_name(isa);
  }
  throw std::runtime_error("ANYNET_ISA=" + std::string(forced) + ": expected one of " + available +
                           " (what this build has and this machine can run)");
}

}  // namespace

const char* isa_name(Isa isa) {
  switch (isa) {
    case Isa::avx512:
      return "avx512";
    case Isa::avx2:
      return "avx2";
    default:
#ifdef __aarch64__
      return "neon";
#else
      return "baseline";
#endif
  }
}

bool isa_available(Isa isa) {
  switch (isa) {
    ANYNET_IF_AVX512(case Isa::avx512 : return __builtin_cpu_supports("avx512f") &&
                         __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
                         __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("fma");)
    ANYNET_IF_AVX2(case Isa::avx2 : return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");)
    case Isa::baseline:
      return true;
    default:
      return false;
  }
}

Isa chosen_isa() {
  static const Isa isa = choose();
  return isa;
}

}  // namespace anynet
