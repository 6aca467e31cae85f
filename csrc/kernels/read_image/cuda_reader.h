// The pixels of read_image.h. For *_cuda.cu only.
#pragma once

#include "../common/cuda.h"

namespace anynet::cuda {

/// An image downsampled and normalized.
template <class T>
struct Reader {
  const uint8_t* image;
  int64_t height, width, factor;
  const T *mean, *std;

  /// The channels of pixel (y, x).
  ANYNET_DEVICE void operator()(int64_t y, int64_t x, T (&out)[3]) const {
    const int64_t first = factor > 2 ? 1 : 0, second = factor / 2;  // of a factor x factor, those that count
    const uint8_t *upper = line(factor * y + first), *lower = line(factor * y + second);
    const int64_t left = column(factor * x + first), right = column(factor * x + second);
#pragma unroll
    for (int c = 0; c < 3; ++c) {
      const int sum =
          __ldg(upper + left + c) + __ldg(upper + right + c) + __ldg(lower + left + c) + __ldg(lower + right + c);
      out[c] = (static_cast<T>(sum) / 4 - read(mean + c)) / read(std + c);
    }
  }

 private:
  ANYNET_DEVICE const uint8_t* line(int64_t y) const { return image + (y < height ? y : height - 1) * width * 3; }
  ANYNET_DEVICE int64_t column(int64_t x) const { return 3 * (x < width ? x : width - 1); }
};

}  // namespace anynet::cuda
