#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>

#include "../../csrc/kernels/common/half.h"

using namespace anynet;

/// The value of a floating-point number with a sign bit, `exponent_bits` and `mantissa_bits`.
double value(int bits, int exponent_bits, int mantissa_bits) {
  const int mantissa = bits & ((1 << mantissa_bits) - 1), exponents = (1 << exponent_bits) - 1;
  const int exponent = bits >> mantissa_bits & exponents, bias = exponents / 2;
  const double sign = bits >> (mantissa_bits + exponent_bits) != 0 ? -1 : 1;
  if (exponent == exponents) return mantissa != 0 ? std::nan("") : sign * std::numeric_limits<double>::infinity();
  const int hidden = exponent != 0 ? 1 << mantissa_bits : 0;
  return sign * std::ldexp(hidden + mantissa, (exponent != 0 ? exponent : 1) - bias - mantissa_bits);
}

void expect(bool right, const char* what, int bits) {
  if (right) return;
  std::printf("%s is wrong around 0x%04x\n", what, bits);
  std::exit(1);
}

/// Every number there is; and between each and the next larger, the middle and its two neighbors.
template <class T, class Narrow>
void test(const char* name, int exponent_bits, int mantissa_bits, const Narrow& narrow) {
  const int infinity = ((1 << exponent_bits) - 1) << mantissa_bits;
  for (int bits = 0; bits < 1 << 16; ++bits) {
    const T number{static_cast<uint16_t>(bits)};
    const double expected = value(bits, exponent_bits, mantissa_bits);
    const float got = to_float(number);
    if (std::isnan(expected)) {
      expect(std::isnan(got) && std::isnan(to_float(narrow(got))), name, bits);
      continue;
    }
    expect(got == expected && std::signbit(got) == std::signbit(expected), name, bits);
    expect(narrow(got).bits == bits, name, bits);
    if ((bits & 0x7fff) == infinity) continue;
    // Beyond the largest number, as if the exponents went on.
    const double step = std::ldexp(1, std::max(std::ilogb(expected), 2 - (1 << (exponent_bits - 1))) - mantissa_bits);
    const float middle = static_cast<float>(expected + std::copysign(step / 2, expected));
    const float less = std::nextafter(middle, 0.0f), more = std::nextafter(middle, 2 * middle);
    expect(narrow(less).bits == bits, name, bits);
    expect(narrow(middle).bits == bits + (bits & 1), name, bits);
    expect(narrow(more).bits == bits + 1, name, bits);
  }
}

int main() {
  test<float16>("float16", 5, 10, to_float16);
  test<bfloat16>("bfloat16", 8, 7, to_bfloat16);
  expect(to_float16(std::numeric_limits<float>::max()).bits == 0x7c00, "float16", 0x7c00);
  expect(to_float16(std::numeric_limits<float>::denorm_min()).bits == 0, "float16", 0);
}
