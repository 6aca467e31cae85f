// Plain checks for the kernels' tests: no framework, no Python, no torch.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <type_traits>
#include <vector>

#include "../../csrc/kernels/common/affine_relu.h"
#include "../../csrc/kernels/common/half.h"
#include "../../csrc/kernels/common/isa.h"
#include "../../csrc/kernels/common/tensor.h"

namespace check {

/// Numbers in [-1, 1], the same on every machine.
class Random {
 public:
  double operator()() {
    state_ = state_ * 6364136223846793005u + 1442695040888963407u;
    return static_cast<double>(state_ >> 33) / (1u << 30) - 1;
  }

 private:
  uint64_t state_ = 20180;
};

template <class T>
double to_double(T a) {
  return static_cast<double>(a);
}
inline double to_double(anynet::float16 a) { return anynet::to_float(a); }
inline double to_double(anynet::bfloat16 a) { return anynet::to_float(a); }

template <class T>
T from_double(double a) {
  return static_cast<T>(a);
}
template <>
inline anynet::float16 from_double<anynet::float16>(double a) {
  return anynet::to_float16(static_cast<float>(a));
}
template <>
inline anynet::bfloat16 from_double<anynet::bfloat16>(double a) {
  return anynet::to_bfloat16(static_cast<float>(a));
}

/// The largest relative error (absolute below 1) that a result of type T may have.
template <class T>
constexpr double tolerance = 1e-4;
template <>
constexpr double tolerance<double> = 1e-11;
template <>
constexpr double tolerance<anynet::float16> = 1.5e-3;
template <>
constexpr double tolerance<anynet::bfloat16> = 1.2e-2;

/// An array with its strides; `at` reads it as double. Allocated to the exact size, so that sanitizers see any overrun.
template <class T, int Rank = 4>
struct Array {
  std::vector<T> values;
  anynet::View<const T, Rank> view;

  /// Columns lie `spread` elements apart.
  template <class Make>
  Array(const std::vector<int64_t>& sizes, Make make, int64_t spread = 1) {
    int64_t count = spread;
    for (int i = Rank; i-- > 0;) {
      view.size[i] = sizes[i];
      view.stride[i] = count;
      count *= sizes[i];
    }
    values.resize(count);
    for (T& v : values) v = from_double<T>(make());
    view.data = values.data();
  }

  template <class... Index>
  double at(Index... index) const {
    const int64_t i[] = {index...};
    int64_t offset = 0;
    for (int r = 0; r < Rank; ++r) offset += i[r] * view.stride[r];
    return to_double(values[offset]);
  }
};

template <class T>
void near(const char* what, T got, double expected, int64_t index) {
  const double error = std::fabs(to_double(got) - expected), scale = std::fmax(1, std::fabs(expected));
  if (error <= tolerance<T> * scale) return;
  std::printf("%s[%lld]: expected %.9g, got %.9g\n", what, static_cast<long long>(index), expected, to_double(got));
  std::exit(1);
}

template <class T>
void near(const char* what, const std::vector<T>& got, const std::vector<double>& expected) {
  for (size_t i = 0; i < got.size(); ++i) near(what, got[i], expected[i], static_cast<int64_t>(i));
}

/// Calls test(isa, T{}, threads) for every instruction set that this machine runs, every type, one and three threads.
template <class Test>
void for_each_variant(const Test& test) {
  for (anynet::Isa isa : {anynet::Isa::baseline, anynet::Isa::avx2, anynet::Isa::avx512}) {
    if (!anynet::isa_available(isa)) {
      std::printf("%s: not on this machine\n", anynet::isa_name(isa));
      continue;
    }
    for (int threads : {1, 3}) {
      test(isa, float{}, threads);
      test(isa, double{}, threads);
      test(isa, anynet::float16{}, threads);
      test(isa, anynet::bfloat16{}, threads);
    }
  }
}

/// The same for kernels of float alone: test(isa, threads).
template <class Test>
void for_each_isa(const Test& test) {
  for_each_variant([&](anynet::Isa isa, auto type, int threads) {
    if constexpr (std::is_same_v<decltype(type), float>) test(isa, threads);
  });
}

/// Random scales and shifts of so many channels.
struct Affine {
  Array<float, 1> scale, shift;

  template <class Make>
  Affine(int64_t channels, Make& make)
      : scale({channels}, [&] { return make(); }), shift({channels}, [&] { return make(); }) {}

  anynet::AffineRelu<float> epilogue() const { return {scale.view.data, shift.view.data, scale.view.size[0]}; }
  double operator()(int64_t channel, double value) const {
    return std::fmax(0, scale.at(channel) * value + shift.at(channel));
  }
};

/// Between element i and i + 1 of an axis of `size`: position p, clamped to the axis.
struct Linear {
  int64_t low, high;
  double fraction;
  Linear(double p, int64_t size) {
    p = std::fmin(std::fmax(p, 0), static_cast<double>(size - 1));
    low = static_cast<int64_t>(p);
    high = low + 1 < size ? low + 1 : low;
    fraction = p - static_cast<double>(low);
  }
};
/// Where element i of an axis of `out` lies on one of `in`, PyTorch's align_corners=False or True.
inline Linear half_pixel(int64_t i, double ratio, int64_t in) {
  return {(static_cast<double>(i) + 0.5) / ratio - 0.5, in};
}
inline Linear corner(int64_t i, int64_t out, int64_t in) {
  return {out > 1 ? static_cast<double>(i) * static_cast<double>(in - 1) / static_cast<double>(out - 1) : 0, in};
}
template <class Read>
double bilinear(const Read& read, const Linear& y, const Linear& x) {
  const double upper = (1 - x.fraction) * read(y.low, x.low) + x.fraction * read(y.low, x.high);
  const double lower = (1 - x.fraction) * read(y.high, x.low) + x.fraction * read(y.high, x.high);
  return (1 - y.fraction) * upper + y.fraction * lower;
}

/// right[i] with zeros outside, between columns by linear interpolation.
template <class Read>
double sample(const Read& row, int64_t width, double position) {
  const double left = std::floor(position), f = position - left;
  const auto pixel = [&](double i) { return i >= 0 && i < width ? row(static_cast<int64_t>(i)) : 0.0; };
  return (1 - f) * pixel(left) + f * pixel(left + 1);
}

}  // namespace check
