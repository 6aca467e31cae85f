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
#include "../../csrc/kernels/batch_norm/batch_norm.h"
#include "../../csrc/kernels/candidates/candidates.h"
#include "../../csrc/kernels/common/simd.h"
#include "../../csrc/kernels/conv/conv.h"
#include "../../csrc/kernels/convex_upsampling/convex_upsampling.h"
#include "../../csrc/kernels/cost_volume/cost_volume.h"
#include "../../csrc/kernels/max_pool/max_pool.h"
#include "../../csrc/kernels/occlusion/occlusion.h"
#include "../../csrc/kernels/read_image/read_image.h"
#include "../../csrc/kernels/refinement_guide/refinement_guide.h"
#include "../../csrc/kernels/soft_argmin/soft_argmin.h"
#include "../../csrc/kernels/spatial_propagation/spatial_propagation.h"
#include "../../csrc/kernels/stem/stem.h"
#include "../../csrc/kernels/upsample/upsample.h"
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
void check_batch_norm(const char* type, int64_t N, int64_t C, int64_t P) {
  const std::string what = describe("batch_norm_relu", type, {N, C, P}, Layout::contiguous);
  const double eps = 1e-3;
  Array<T, 3> input({N, C, P}), grad({N, C, P}), out({N, C, P}), grad_input({N, C, P});
  Array<T, 1> weight({C}), bias({C}), mean({C}), variance({C}), grad_weight({C}), grad_bias({C});
  Array<double, 1> sums({cuda::batch_norm_sums(N, C, P)});
  baseline::batch_norm_relu<T>({N, C, P, input.host_data(), weight.host_data(), bias.host_data(), eps, out.host_data(),
                                mean.host_data(), variance.host_data()},
                               1);
  cuda::batch_norm_relu<T>({N, C, P, input.device_data(), weight.device_data(), bias.device_data(), eps,
                            out.device_data(), mean.device_data(), variance.device_data(), sums.device_data()},
                           nullptr);
  out.compare(what);
  mean.compare(what + ", mean");
  variance.compare(what + ", variance");
  baseline::batch_norm_relu_backward<T>(
      {N, C, P, grad.host_data(), input.host_data(), weight.host_data(), bias.host_data(), mean.host_data(),
       variance.host_data(), eps, grad_input.host_data(), grad_weight.host_data(), grad_bias.host_data()},
      1);
  cuda::batch_norm_relu_backward<T>(
      {N, C, P, grad.device_data(), input.device_data(), weight.device_data(), bias.device_data(), mean.device_data(),
       variance.device_data(), eps, grad_input.device_data(), grad_weight.device_data(), grad_bias.device_data(),
       sums.device_data()},
      nullptr);
  grad_input.compare(what + " backward, input");
  grad_weight.compare(what + " backward, weight");
  grad_bias.compare(what + " backward, bias");
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
  if constexpr (sizeof(T) >= sizeof(float)) {
    check_batch_norm<T>(type, 2, 1, 1);
    check_batch_norm<T>(type, 3, 2, 35);
    check_batch_norm<T>(type, 2, 3, 4100);  // two pieces per plane
  }
}

// ------------------------------------------------------------------------------------ of the deployed network, in
// float
using Floats = Array<float, 1>;

/// Its place on the host or on the device.
float* at(Floats& array, bool device) { return device ? array.device_data() : array.host_data(); }

AffineRelu<float> affine(Floats& scale, Floats& shift, int64_t channels, bool device) {
  return {at(scale, device), at(shift, device), channels};
}

class Image {
 public:
  explicit Image(int64_t bytes) : host_(bytes) {
    for (uint8_t& b : host_) b = static_cast<uint8_t>(generator());
    expect(cudaMalloc(reinterpret_cast<void**>(&device_), host_.size()));
    expect(cudaMemcpy(device_, host_.data(), host_.size(), cudaMemcpyHostToDevice));
  }
  ~Image() { cudaFree(device_); }
  Image(const Image&) = delete;
  const uint8_t* at(bool device) const { return device ? device_ : host_.data(); }

 private:
  std::vector<uint8_t> host_;
  uint8_t* device_ = nullptr;
};

void check_conv(int64_t kernel_depth, int64_t stride, int64_t C, int64_t O, int64_t D, int64_t H, int64_t W) {
  const ConvShape shape{2, C, O, D, H, W, kernel_depth, stride};
  const auto strided = [&](int64_t size) { return (size - 1) / stride + 1; };
  const int64_t depth = kernel_depth == 3 ? strided(D) : D;
  Floats input({2 * C * D * H * W}), weight({O * C * kernel_depth * 9}), bias({O}), scale({C}), shift({C});
  Floats out({2 * O * depth * strided(H) * strided(W)});
  const auto args = [&](bool device) {
    return Conv<float>{
        shape, at(input, device), at(weight, device), at(bias, device), at(scale, device), at(shift, device),
        true,  C % 2 == 0,        at(out, device)};
  };
  baseline::conv<float>(args(false), 1);
  cuda::conv<float>(args(true), nullptr);
  out.compare(describe("conv", "float", {kernel_depth, stride, C, O, D, H, W}, Layout::contiguous));
}

void check_conv_pair(int64_t kernel_depth, int64_t C, int64_t M, int64_t O, int64_t D, int64_t H, int64_t W) {
  Floats input({2 * C * D * H * W}), first({M * C * kernel_depth * 9}), second({O * M * kernel_depth * 9});
  Floats between({2 * M * D * H * W}), bias({M}), out({2 * O * D * H * W});
  const ConvShape shape{2, C, M, D, H, W, kernel_depth, 1}, next{2, M, O, D, H, W, kernel_depth, 1};
  baseline::conv<float>(
      {shape, at(input, false), at(first, false), at(bias, false), nullptr, nullptr, false, true, at(between, false)},
      1);
  baseline::conv<float>(
      {next, at(between, false), at(second, false), nullptr, nullptr, nullptr, false, false, at(out, false)}, 1);
  cuda::conv_pair(
      {shape, O, at(input, true), at(first, true), at(bias, true), at(second, true), nullptr, false, at(out, true)},
      nullptr);
  out.compare(describe("conv_pair", "float", {kernel_depth, C, M, O, D, H, W}, Layout::contiguous));
}

void check_images(int64_t H, int64_t W, int64_t C, int64_t scale) {
  const Image left(H * W * 3), right(H * W * 3);
  Floats mean({3}), deviation({3}), first({C * 27}), bias({C}), second({C * C * 9}), gain({C}), shift({C});
  const int64_t height = (scale * H + 3) / 4 * 4, width = (scale * W + 3) / 4 * 4;
  Floats out({2 * C * height / 4 * width / 4});
  const auto args = [&](bool device) {
    return Stem<float>{{left.at(device), right.at(device)},
                       H,
                       W,
                       scale,
                       height,
                       width,
                       C,
                       at(mean, device),
                       at(first, device),
                       at(bias, device),
                       at(second, device),
                       affine(gain, shift, C, device),
                       at(out, device)};
  };
  baseline::stem<float>(args(false), 1);
  cuda::stem<float>(args(true), nullptr);
  out.compare(describe("stem", "float", {H, W, C, scale}, Layout::contiguous));
  std::fill_n(deviation.host_data(), 3, 2.0f);
  expect(cudaMemcpy(deviation.device_data(), deviation.host_data(), deviation.bytes(), cudaMemcpyHostToDevice));
  Floats small({3 * 4 * H * W});
  const auto reading = [&](bool device) {
    return ReadImage<float>{left.at(device),  H, W, 2 * scale, 2, H, W, at(mean, device), at(deviation, device),
                            at(small, device)};
  };
  baseline::read_image<float>(reading(false), 1);
  cuda::read_image<float>(reading(true), nullptr);
  small.compare(describe("read_image", "float", {H, W, scale}, Layout::contiguous));
  Floats disparity({H * W}), guide({16 * H * W});
  for (int64_t i = 0; i < H * W; ++i)
    disparity.host_data()[i] = 4 * disparity.host_data()[i] + static_cast<float>(i % 9);
  expect(cudaMemcpy(disparity.device_data(), disparity.host_data(), disparity.bytes(), cudaMemcpyHostToDevice));
  const auto guiding = [&](bool device) {
    return RefinementGuide<float>{{left.at(device), right.at(device)},
                                  H,
                                  W,
                                  2 * scale,
                                  2,
                                  H,
                                  W,
                                  at(disparity, device),
                                  at(mean, device),
                                  at(deviation, device),
                                  at(guide, device)};
  };
  baseline::refinement_guide<float>(guiding(false), 1);
  cuda::refinement_guide<float>(guiding(true), nullptr);
  guide.compare(describe("refinement_guide", "float", {H, W, scale}, Layout::contiguous));
}

void check_maps(int64_t H, int64_t W) {
  const int64_t N = 2, C = 4, pixels = H * W;
  const std::vector<int64_t> size{H, W};
  Floats map({N * C * pixels}), scale({C}), shift({C}), coarse({N * C * pixels}),
      disparity({pixels}, Layout::contiguous, 40);
  Floats out({N * C * 4 * 4 * pixels});
  const auto expect_equal = [&](const char* op, const std::function<void(bool)>& run) {
    run(false);
    run(true);
    out.compare(describe(op, "float", size, Layout::contiguous));
  };
#define RUN(kernel, ...)                   \
  expect_equal(#kernel, [&](bool device) { \
    const auto args = __VA_ARGS__;         \
    if (device) {                          \
      cuda::kernel<float>(args, nullptr);  \
    } else {                               \
      baseline::kernel<float>(args, 1);    \
    }                                      \
  })
  RUN(max_pool, MaxPool<float>{N, C, H, W, at(map, device), affine(scale, shift, C, device), at(out, device)});
  RUN(upsample_concat, UpsampleConcat<float>{N, 2, 2, H, W, (H + 1) / 2, (W + 1) / 2, at(map, device),
                                             at(coarse, device), affine(scale, shift, C, device), at(out, device)});
  RUN(upsample_add, UpsampleAdd<float>{1, C, N, H, W, 1, (H + 1) / 2, (W + 1) / 2, at(map, device), at(coarse, device),
                                       affine(scale, shift, C, device), at(out, device)});
  RUN(upsample_sum, UpsampleSum<float>{2,
                                       {at(map, device), at(coarse, device)},
                                       {H, 2 * H},
                                       {W, 2 * W},
                                       {2, 1},
                                       {0.5f, 2.0f},
                                       0.25f,
                                       2 * H,
                                       2 * W,
                                       at(out, device)});
  RUN(candidate_costs,
      CandidateCosts<float>{C, 2, H, W, at(map, device), at(disparity, device), -2, 5, 2, at(out, device)});
  RUN(expected_disparity, ExpectedDisparity<float>{6, pixels, at(map, device), at(disparity, device),
                                                   at(coarse, device), -2, at(out, device)});
  RUN(fill_occlusions, FillOcclusions<float>{C * H, W, at(map, device), 0.125f, at(out, device)});
  Floats logits({32 * pixels});
  RUN(convex_upsampling, ConvexUpsampling<float>{1, H, W, at(map, device), at(logits, device), at(out, device)});
  Floats gates({3 * C * pixels});
  for (int direction = 0; direction < 4; ++direction) {
    RUN(spatial_propagation,
        SpatialPropagation<float>{{at(map, device), {1, C, H, W}, {C * pixels, pixels, W, 1}},
                                  {at(gates, device), {1, 3, C, H, W}, {3 * C * pixels, C * pixels, pixels, W, 1}},
                                  direction,
                                  at(out, device),
                                  true});
  }
  const View4<const float> none{};
  for (bool around : {false, true}) {
    const auto view = [&](Floats& array, int64_t c, bool device) {
      return View4<const float>{at(array, device), {2, c, H, W}, {c * pixels, pixels, W, 1}};
    };
    RUN(cost_volume,
        CostVolume<float>{view(map, 4, device), view(coarse, 4, device), around ? view(logits, 1, device) : none, -2, 5,
                          at(out, device), affine(scale, shift, 2, device)});
  }
#undef RUN
}

void check_deployed() {
  for (int64_t stride : {1, 2}) {
    check_conv(1, stride, 3, 2, 1, 7, 37);
    check_conv(1, stride, 6, 9, 1, 5, 33);
    check_conv(3, stride, 5, 1, 3, 5, 34);
  }
  check_conv_pair(1, 3, 5, 2, 1, 9, 35);
  check_conv_pair(3, 1, 4, 4, 5, 7, 18);
  check_images(13, 37, 1, 1);
  check_images(9, 10, 10, 2);
  check_maps(1, 1);
  check_maps(5, 38);
  check_maps(19, 33);
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
  check_deployed();
  std::printf("%d of %d comparisons failed\n", failures, checks);
#ifdef ANYNET_EMULATED
  (void)argc, (void)argv;
#else
  if (argc > 1 && std::strcmp(argv[1], "--time") == 0) time_all();
#endif
  return failures == 0 ? 0 : 1;
}
