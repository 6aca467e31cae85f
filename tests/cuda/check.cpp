// Checks the CUDA kernels against the CPU kernels without PyTorch or Python. Two programs come of it: cuda_check, for a
// GPU, and cuda_check_emulated, which is what the sanitizers watch on machines without one.
//
//   cuda_check           every operator, element type and a choice of shapes and layouts
//   cuda_check --time    then also milliseconds and GB/s at the sizes of AnyNet, beside those of a plain copy
#include <cuda_runtime.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <functional>
#include <random>
#include <string>
#include <vector>

#define ANYNET_ISA baseline
#include "../../csrc/kernels/common/simd.h"
#include "../../csrc/kernels/cost_volume/cost_volume.h"
#include "../../csrc/kernels/soft_argmin/soft_argmin.h"
#include "../../csrc/kernels/spatial_propagation/spatial_propagation.h"
#include "../../csrc/kernels/warp/warp.h"

using namespace anynet;

namespace {

int failures = 0, checks = 0;
std::mt19937 generator(5);

void expect(cudaError_t error) {
  if (error == cudaSuccess) return;
  std::fprintf(stderr, "CUDA error: %s\n", cudaGetErrorString(error));
  std::exit(1);
}

enum class Layout { contiguous, channels_last, sliced };

/// An array on the host and its copy on the device. Values are small multiples of 1/8, so that sums and samples are
/// exact and both sides must agree on every sign.
template <class T, int Rank = 4>
class Array {
 public:
  Array(std::vector<int64_t> size, Layout layout = Layout::contiguous, int limit = 16) : size_(size) {
    std::vector<int> order(Rank);
    for (int i = 0; i < Rank; ++i) order[i] = i;
    if (layout == Layout::channels_last) std::rotate(order.begin() + 1, order.begin() + 2, order.end());
    int64_t stride = layout == Layout::sliced ? 2 : 1;
    stride_.resize(Rank);
    for (int i = Rank - 1; i >= 0; --i) {
      stride_[order[i]] = stride;
      stride *= size[order[i]] + (layout == Layout::sliced ? 1 : 0);
    }
    host_.resize(1);
    int64_t last = 1;
    for (int i = 0; i < Rank; ++i) last += std::max<int64_t>(size[i] - 1, 0) * stride_[i];
    host_.resize(last);
    std::uniform_int_distribution<int> value(-limit, limit);
    for (T& v : host_) v = baseline::from_accumulator<T>(static_cast<accumulator_t<T>>(value(generator)) / 8);
    expect(cudaMalloc(&device_, host_.size() * sizeof(T)));
    expect(cudaMemcpy(device_, host_.data(), host_.size() * sizeof(T), cudaMemcpyHostToDevice));
  }
  ~Array() { cudaFree(device_); }
  Array(const Array&) = delete;

  View<const T, Rank> host() const { return view(host_.data()); }
  View<const T, Rank> device() const { return view(static_cast<const T*>(device_)); }
  T* host_data() { return host_.data(); }
  T* device_data() { return static_cast<T*>(device_); }
  int64_t bytes() const { return static_cast<int64_t>(host_.size() * sizeof(T)); }

  /// Whether the device's copy, downloaded, equals the host's up to rounding.
  void compare(const std::string& what) {
    std::vector<T> result(host_.size());
    expect(cudaMemcpy(result.data(), device_, result.size() * sizeof(T), cudaMemcpyDeviceToHost));
    const double tolerance = sizeof(T) == 8 ? 1e-12 : sizeof(T) == 4 ? 2e-5 : std::is_same_v<T, float16> ? 2e-3 : 1e-2;
    ++checks;
    for (size_t i = 0; i < result.size(); ++i) {
      const double a = baseline::to_accumulator(result[i]), b = baseline::to_accumulator(host_[i]);
      if (std::abs(a - b) <= tolerance * (1 + std::abs(b))) continue;
      std::printf("FAILED %s: element %zu is %.9g, expected %.9g\n", what.c_str(), i, a, b);
      ++failures;
      return;
    }
  }

 private:
  View<const T, Rank> view(const T* data) const {
    View<const T, Rank> v;
    v.data = data;
    std::copy(size_.begin(), size_.end(), v.size);
    std::copy(stride_.begin(), stride_.end(), v.stride);
    return v;
  }

  std::vector<int64_t> size_, stride_;
  std::vector<T> host_;
  void* device_ = nullptr;
};

std::string describe(const char* op, const char* type, const std::vector<int64_t>& numbers, Layout layout) {
  std::string text = std::string(op) + " " + type;
  for (int64_t n : numbers) text += " " + std::to_string(n);
  return text + (layout == Layout::contiguous ? "" : layout == Layout::sliced ? " sliced" : " channels last");
}

template <class T>
void check_soft_argmin(const char* type, int64_t N, int64_t D, int64_t H, int64_t W, Layout layout) {
  const std::string what = describe("soft_argmin", type, {N, D, H, W}, layout);
  const Array<T> cost({N, D, H, W}, layout), grad({N, 1, H, W}, layout);
  Array<T> out({N, 1, H, W}), grad_cost({N, D, H, W});
  baseline::soft_argmin<T>({cost.host(), -2, out.host_data()}, 1);
  cuda::soft_argmin<T>({cost.device(), -2, out.device_data()}, nullptr);
  out.compare(what);
  baseline::soft_argmin_backward<T>({grad.host(), cost.host(), -2, grad_cost.host_data()}, 1);
  cuda::soft_argmin_backward<T>({grad.device(), cost.device(), -2, grad_cost.device_data()}, nullptr);
  grad_cost.compare(what + " backward");
}

template <class T>
void check_warp(const char* type, int64_t N, int64_t C, int64_t H, int64_t W, Layout layout) {
  const std::string what = describe("warp", type, {N, C, H, W}, layout);
  const Array<T> image({N, C, H, W}, layout), disparity({N, 1, H, W}, layout, 40), grad({N, C, H, W}, layout);
  Array<T> out({N, C, H, W}), grad_image({N, C, H, W}), grad_disparity({N, 1, H, W});
  baseline::warp<T>({image.host(), disparity.host(), out.host_data()}, 1);
  cuda::warp<T>({image.device(), disparity.device(), out.device_data()}, nullptr);
  out.compare(what);
  baseline::warp_backward<T>(
      {grad.host(), image.host(), disparity.host(), grad_image.host_data(), grad_disparity.host_data()}, 1);
  cuda::warp_backward<T>(
      {grad.device(), image.device(), disparity.device(), grad_image.device_data(), grad_disparity.device_data()},
      nullptr);
  grad_image.compare(what + " backward, image");
  grad_disparity.compare(what + " backward, disparity");
}

template <class T>
void check_cost_volume(const char* type, int64_t N, int64_t C, int64_t H, int64_t W, int64_t first, int64_t K,
                       bool with_disparity, Layout layout) {
  const std::string what =
      describe(with_disparity ? "cost_volume with disparity" : "cost_volume", type, {N, C, H, W, first, K}, layout);
  const Array<T> left({N, C, H, W}, layout), right({N, C, H, W}, layout), map({N, 1, H, W}, layout, 40),
      grad({N, K, H, W}, layout);
  Array<T> out({N, K, H, W}), grad_left({N, C, H, W}), grad_right({N, C, H, W}), grad_map({N, 1, H, W});
  const View4<const T> none{}, on_host = with_disparity ? map.host() : none,
                               on_device = with_disparity ? map.device() : none;
  baseline::cost_volume<T>({left.host(), right.host(), on_host, first, K, out.host_data()}, 1);
  cuda::cost_volume<T>({left.device(), right.device(), on_device, first, K, out.device_data()}, nullptr);
  out.compare(what);
  baseline::cost_volume_backward<T>({grad.host(), left.host(), right.host(), on_host, first, K, grad_left.host_data(),
                                     grad_right.host_data(), with_disparity ? grad_map.host_data() : nullptr},
                                    1);
  cuda::cost_volume_backward<T>(
      {grad.device(), left.device(), right.device(), on_device, first, K, grad_left.device_data(),
       grad_right.device_data(), with_disparity ? grad_map.device_data() : nullptr},
      nullptr);
  grad_left.compare(what + " backward, left");
  grad_right.compare(what + " backward, right");
  if (with_disparity) grad_map.compare(what + " backward, disparity");
}

template <class T>
void check_spatial_propagation(const char* type, int64_t N, int64_t C, int64_t H, int64_t W, int direction,
                               Layout layout) {
  const std::string what = describe("spatial_propagation", type, {N, C, H, W, direction}, layout);
  const Array<T> input({N, C, H, W}, layout), grad({N, C, H, W}, layout);
  const Array<T, 5> gates({N, 3, C, H, W}, layout, 2);  // at most 1/4 each: the scan contracts
  const Array<T> h({N, C, H, W}, layout);
  Array<T> out({N, C, H, W}), grad_input({N, C, H, W}), grad_gates({N, 3 * C, H, W});
  baseline::spatial_propagation<T>({input.host(), gates.host(), direction, out.host_data()}, 1);
  cuda::spatial_propagation<T>({input.device(), gates.device(), direction, out.device_data()}, nullptr);
  out.compare(what);
  baseline::spatial_propagation_backward<T>(
      {grad.host(), input.host(), gates.host(), h.host(), direction, grad_input.host_data(), grad_gates.host_data()},
      1);
  cuda::spatial_propagation_backward<T>({grad.device(), input.device(), gates.device(), h.device(), direction,
                                         grad_input.device_data(), grad_gates.device_data()},
                                        nullptr);
  grad_input.compare(what + " backward, input");
  grad_gates.compare(what + " backward, gates");
}

template <class T>
void check_all(const char* type) {
  for (Layout layout : {Layout::contiguous, Layout::channels_last, Layout::sliced}) {
    check_soft_argmin<T>(type, 2, 12, 3, 16, layout);
    check_soft_argmin<T>(type, 1, 5, 7, 33, layout);
    check_warp<T>(type, 2, 3, 3, 40, layout);
    check_warp<T>(type, 1, 6, 1, 7, layout);
    for (bool with_disparity : {false, true}) {
      check_cost_volume<T>(type, 1, 5, 3, 40, 0, 12, with_disparity, layout);
      check_cost_volume<T>(type, 2, 2, 2, 33, -2, 5, with_disparity, layout);
    }
    for (int direction = 0; direction < 4; ++direction) {
      check_spatial_propagation<T>(type, 1, 2, 5, 24, direction, layout);
      check_spatial_propagation<T>(type, 2, 1, 19, 9, direction, layout);
    }
  }
  check_soft_argmin<T>(type, 1, 1, 1, 1, Layout::contiguous);
  check_cost_volume<T>(type, 1, 9, 1, 140, -3, 140, false, Layout::contiguous);  // two tiles of pixels and of offsets
  check_cost_volume<T>(type, 1, 9, 1, 140, -3, 70, true, Layout::contiguous);
  check_spatial_propagation<T>(type, 1, 1, 600, 3, 0, Layout::contiguous);  // more lines than threads
  check_spatial_propagation<T>(type, 1, 1, 3, 600, 3, Layout::contiguous);
}

#ifndef ANYNET_EMULATED
/// Median milliseconds of 50 calls, each between two events; the cache is overwritten in between.
double time(const std::function<void()>& call) {
  static Array<float> flush({1, 1, 64, 1 << 20});
  cudaEvent_t begin, end;
  expect(cudaEventCreate(&begin));
  expect(cudaEventCreate(&end));
  std::vector<float> times;
  for (int i = 0; i < 60; ++i) {
    expect(cudaMemsetAsync(flush.device_data(), 0, flush.bytes()));
    expect(cudaEventRecord(begin));
    call();
    expect(cudaEventRecord(end));
    expect(cudaEventSynchronize(end));
    float ms = 0;
    expect(cudaEventElapsedTime(&ms, begin, end));
    if (i >= 10) times.push_back(ms);
  }
  std::sort(times.begin(), times.end());
  return times[times.size() / 2];
}

void report(const char* name, int64_t bytes, const std::function<void()>& call) {
  const double ms = time(call);
  std::printf("%-48s %9.4f ms %9.1f GB/s\n", name, ms, bytes / ms * 1e-6);
}

void time_all() {
  Array<float> from({1, 1, 32, 1 << 20}), to({1, 1, 32, 1 << 20});
  report("copy of 128 MiB", 2 * from.bytes(), [&] {
    expect(cudaMemcpyAsync(to.device_data(), from.device_data(), from.bytes(), cudaMemcpyDeviceToDevice));
  });
  struct Stage {
    int64_t C, H, W, first, K;
    bool with_disparity;
  };
  for (const Stage& s : {Stage{8, 24, 80, 0, 12, false},
                         {4, 48, 160, -2, 5, true},
                         {2, 96, 320, -2, 5, true},
                         {32, 384, 1280, 0, 48, false},
                         {32, 384, 1280, -2, 5, true}}) {
    Array<float> left({1, s.C, s.H, s.W}), right({1, s.C, s.H, s.W}), map({1, 1, s.H, s.W}), out({1, s.K, s.H, s.W});
    const View4<const float> none{}, disparity = s.with_disparity ? map.device() : none;
    const int64_t maps = s.with_disparity ? map.bytes() : 0, pair = left.bytes() + right.bytes();
    const std::string size = std::to_string(s.C) + "x" + std::to_string(s.H) + "x" + std::to_string(s.W) + "x" +
                             std::to_string(s.K) + (s.with_disparity ? " with disparity" : "");
    report(("cost_volume " + size).c_str(), pair + out.bytes() + maps, [&] {
      cuda::cost_volume<float>({left.device(), right.device(), disparity, s.first, s.K, out.device_data()}, nullptr);
    });
    Array<float> grad_left({1, s.C, s.H, s.W}), grad_right({1, s.C, s.H, s.W}), grad_map({1, 1, s.H, s.W});
    report(("cost_volume_backward " + size).c_str(), 2 * pair + out.bytes() + 2 * maps, [&] {
      cuda::cost_volume_backward<float>(
          {out.device(), left.device(), right.device(), disparity, s.first, s.K, grad_left.device_data(),
           grad_right.device_data(), s.with_disparity ? grad_map.device_data() : nullptr},
          nullptr);
    });
    report(("soft_argmin " + size).c_str(), out.bytes() + map.bytes(),
           [&] { cuda::soft_argmin<float>({out.device(), s.first, map.device_data()}, nullptr); });
    report(("warp " + size).c_str(), 2 * left.bytes() + map.bytes(),
           [&] { cuda::warp<float>({left.device(), map.device(), grad_left.device_data()}, nullptr); });
  }
  for (int direction = 0; direction < 4; ++direction) {
    Array<float> input({1, 8, 96, 320}), out({1, 8, 96, 320});
    Array<float, 5> gates({1, 3, 8, 96, 320}, Layout::contiguous, 2);
    report(("spatial_propagation 8x96x320, direction " + std::to_string(direction)).c_str(),
           2 * input.bytes() + gates.bytes(), [&] {
             cuda::spatial_propagation<float>({input.device(), gates.device(), direction, out.device_data()}, nullptr);
           });
  }
}
#endif

}  // namespace

int main(int argc, char** argv) {
  check_all<float>("float32");
  check_all<double>("float64");
  check_all<float16>("float16");
  check_all<bfloat16>("bfloat16");
  std::printf("%d of %d comparisons failed\n", failures, checks);
#ifdef ANYNET_EMULATED
  (void)argc, (void)argv;
#else
  if (argc > 1 && std::strcmp(argv[1], "--time") == 0) time_all();
#endif
  return failures == 0 ? 0 : 1;
}
