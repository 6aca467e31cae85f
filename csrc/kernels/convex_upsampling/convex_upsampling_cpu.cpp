#include <algorithm>

#include "../common/exp.h"
#include "../common/parallel.h"
#include "../common/scratch.h"
#include "../common/simd.h"
#include "convex_upsampling.h"

namespace anynet::ANYNET_ISA {

template <class T>
void convex_upsampling(const ConvexUpsampling<T>& a, int threads) {
  // Whole vectors and a column on either side, so that the last vector of a row needs no case of its own.
  const int64_t padded = round_up(a.width, lanes<T>) + 2, plane = a.height * a.width;
  const int64_t rows = a.batch * a.height;
  parallel_ranges(rows, useful_threads(threads, rows, a.width, 256), [&](int64_t begin, int64_t end) {
    const Scratch<T> around(3 * padded), even(padded), odd(padded);
    for (int64_t task = begin; task < end; ++task) {
      const int64_t n = task / a.height, y = task % a.height;
      for (int64_t i = 0; i < 3; ++i) {
        const T* row = a.in + n * plane + std::clamp<int64_t>(y + i - 1, 0, a.height - 1) * a.width;
        T* line = around + i * padded;
        line[0] = row[0];
        std::copy_n(row, a.width, line + 1);
        std::fill(line + 1 + a.width, line + padded, row[a.width - 1]);
      }
      const T* logits = a.logits + n * 32 * plane + y * a.width;
      const auto upsample = [&](const T* logits, T* line) {
        for (int64_t x = 0; x < a.width; x += lanes<T>) {
          vec<T> logit[8], most{};
          for (int k = 0; k < 8; ++k) {
            logit[k] = read_vector(logits + k * plane + x, 1, std::min<int64_t>(a.width - x, lanes<T>));
            most = max<T>(most, logit[k]);
          }
          vec<T> sum = exp_nonpositive<T>(-most), value = sum * load(around + padded + x + 1);
          for (int k = 0; k < 8; ++k) {
            const int i = k < 4 ? k : k + 1;
            const vec<T> weight = exp_nonpositive<T>(logit[k] - most);
            sum += weight;
            value += weight * load(around + i / 3 * padded + i % 3 + x);
          }
          store(line + x, value / sum);
        }
      };
      for (int64_t i = 0; i < 2; ++i) {
        upsample(logits + 16 * i * plane, even);
        upsample(logits + (16 * i + 8) * plane, odd);
        T* __restrict out = a.out + (task * 2 + i) * 2 * a.width;
        const T* __restrict left = even, * __restrict right = odd;
        for (int64_t x = 0; x < a.width; ++x) {
          out[2 * x] = left[x];
          out[2 * x + 1] = right[x];
        }
      }
    }
  });
}

template void convex_upsampling<float>(const ConvexUpsampling<float>&, int);

}  // namespace anynet::ANYNET_ISA
