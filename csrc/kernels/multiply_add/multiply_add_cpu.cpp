#include <utility>

#include "../common/parallel.h"
#include "../common/simd.h"
#include "multiply_add.h"

namespace anynet::ANYNET_ISA {
namespace {

constexpr int chains = 12;  // enough for a latency of six cycles on two ports, few enough for 16 registers

/// Hides where a value comes from, so that the compiler computes with it again and again.
template <class V>
ANYNET_INLINE void hide(V& value) {
#ifdef __aarch64__
  asm("" : "+w"(value));
#else
  asm("" : "+v"(value));
#endif
}

/// A loop over the chains would keep them in memory, and so might inlining this function.
template <class T, int... I>
__attribute__((noinline)) T sum_of_chains(int64_t rounds, T factor, T other, std::integer_sequence<int, I...>) {
  vec<T> factors = splat(factor), others = splat(other), x[] = {(static_cast<void>(I), vec<T>{})...};
  for (int64_t round = 0; round < rounds; ++round) ((x[I] += factors * others, hide(factors)), ...);
  const vec<T> sums = (x[I] + ...);
  T sum = 0;
  for (int i = 0; i < lanes<T>; ++i) sum += sums[i];
  return sum;
}

}  // namespace

template <class T>
void multiply_add(const MultiplyAdd<T>& a, int threads) {
  parallel_for(threads, threads, [&](int64_t thread) {
    a.out[thread] = sum_of_chains(a.rounds, a.factor, a.other, std::make_integer_sequence<int, chains>{});
  });
  *a.count = threads * a.rounds * chains * lanes<T>;
}

template void multiply_add<float>(const MultiplyAdd<float>&, int);

}  // namespace anynet::ANYNET_ISA
