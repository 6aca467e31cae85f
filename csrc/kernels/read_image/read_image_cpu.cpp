#include <algorithm>

#include "../common/parallel.h"
#include "read_image.h"

namespace anynet::ANYNET_ISA {

template <class T>
void read_image(const ReadImage<T>& a, int threads) {
  const int64_t first = std::max<int64_t>(a.factor / 2 - 1, 0), second = a.factor / 2;
  const T gain[3] = {T(0.25) / a.std[0], T(0.25) / a.std[1], T(0.25) / a.std[2]};
  const int64_t plane = a.height * a.width, rows = a.block * a.height;
  parallel_for(rows, useful_threads(threads, rows, a.block, a.width, 16), [&](int64_t row) {
    const auto line = [&](int64_t y) { return a.image + std::min(y, a.image_height - 1) * a.image_width * 3; };
    const auto column = [&](int64_t x) { return 3 * std::min(x, a.image_width - 1); };
    const uint8_t *upper = line(a.factor * row + first), *lower = line(a.factor * row + second);
    for (int64_t j = 0; j < a.block; ++j) {
      T* out = a.out + (row % a.block * a.block + j) * plane + row / a.block * a.width;
      for (int64_t x = 0; x < a.width; ++x) {
        const int64_t from = a.factor * (a.block * x + j), left = column(from + first), right = column(from + second);
        for (int c = 0; c < 3; ++c) {
          const int32_t sum = upper[left + c] + upper[right + c] + lower[left + c] + lower[right + c];
          out[c * a.block * a.block * plane + x] = (static_cast<T>(sum) - 4 * a.mean[c]) * gain[c];
        }
      }
    }
  });
}

template void read_image<float>(const ReadImage<float>&, int);

}  // namespace anynet::ANYNET_ISA
