// candidate_costs: one thread per pixel and group of channels, and one more per pixel for what all groups share; each
// looks for the window's extremes itself. expected_disparity: one thread per pixel, which reads the costs twice.
#include <cmath>

#include "../common/cuda.h"
#include "../common/cuda_sampling.h"
#include "candidates.h"

namespace anynet::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(Pixel::threads_per_block) costs(CandidateCosts<T> a) {
  const Pixel at(a.width);
  const int64_t task = at.row / a.height, y = at.row % a.height, pixels = a.height * a.width;
  if (task > a.groups || at.x >= a.width) return;
  const int64_t here = y * a.width + at.x;
  const T disparity = read(a.disparity + here);
  T largest = disparity, smallest = disparity;
  const int64_t left = at.x > a.radius ? at.x - a.radius : 0, top = y > a.radius ? y - a.radius : 0;
  for (int64_t i = top; i <= y + a.radius && i < a.height; ++i) {
    for (int64_t j = left; j <= at.x + a.radius && j < a.width; ++j) {
      const T d = read(a.disparity + i * a.width + j);
      largest = largest < d ? d : largest;
      smallest = d < smallest ? d : smallest;
    }
  }
  T* const shared = a.out + a.groups * (a.count + 2) * pixels + here;  // left, offsets
  if (task == a.groups) {
    for (int64_t c = 0; c < a.channels; ++c) shared[c * pixels] = read(a.features + c * pixels + here);
    shared[a.channels * pixels] = largest - disparity;
    shared[(a.channels + 1) * pixels] = smallest - disparity;
    return;
  }
  const int64_t channels = a.channels / a.groups;
  const T* features = a.features + task * channels * pixels + y * a.width;
  const int width = static_cast<int>(a.width), x = static_cast<int>(at.x);
  const auto cost = [&](T d, int64_t offset) {
    const Position<T> from = locate(x, d, offset, -2, width);
    T sum = 0;
    for (int64_t c = 0; c < channels; ++c) {
      const T *own = features + c * pixels, *other = own + a.channels * pixels;
      sum += fabs(read(own + x) -
                  sample(from, pixel(other, 1, from.index, width), pixel(other, 1, from.index + 1, width)));
    }
    return sum;
  };
  for (int64_t k = 0; k < a.count + 2; ++k) {  // one call of `cost` is inlined, three are not
    const bool around = k < a.count;
    const T d = around ? disparity : k == a.count ? largest : smallest;
    const int64_t plane = around ? task * a.count + k : a.groups * k + task;
    a.out[plane * pixels + here] = cost(d, around ? a.first + k : 0);
  }
}

constexpr int threads_per_block = 128;

template <class T>
__global__ void __launch_bounds__(threads_per_block) expect(ExpectedDisparity<T> a) {
  const int64_t i = static_cast<int64_t>(blockIdx.x) * threads_per_block + threadIdx.x;
  if (i >= a.pixels) return;
  const T* cost = a.cost + i;
  T least = read(cost);
  for (int64_t k = 1; k < a.count; ++k) {
    const T c = read(cost + k * a.pixels);
    least = c < least ? c : least;
  }
  T sum = 0, mean = 0;
  for (int64_t k = 0; k < a.count; ++k) {
    const int64_t offset = k - (a.count - 2);
    const T weight = exp(least - read(cost + k * a.pixels));
    sum += weight;
    mean += weight * (offset < 0 ? a.first + static_cast<T>(k) : read(a.offsets + offset * a.pixels + i));
  }
  a.out[i] = read(a.disparity + i) + mean / sum;
}

}  // namespace

template <class T>
void candidate_costs(const CandidateCosts<T>& a, Stream stream) {
  check_row("candidate_costs", a.width, a.count);
  launch("candidate_costs", costs<T>, Pixel::blocks((a.groups + 1) * a.height, a.width), Pixel::threads(), 0, stream,
         a);
}

template <class T>
void expected_disparity(const ExpectedDisparity<T>& a, Stream stream) {
  launch("expected_disparity", expect<T>, ceil_div(a.pixels, threads_per_block), threads_per_block, 0, stream, a);
}

template void candidate_costs<float>(const CandidateCosts<float>&, Stream);
template void expected_disparity<float>(const ExpectedDisparity<float>&, Stream);

}  // namespace anynet::cuda
