#include "../../csrc/kernels/stem/stem.h"
#include "check.h"

using namespace anynet;

void test(Isa isa, int threads, int64_t image_height, int64_t image_width, int64_t C, int64_t scale, int64_t multiple) {
  check::Random random;
  std::vector<uint8_t> images[2];
  for (auto& image : images) {
    image.resize(image_height * image_width * 3);
    for (uint8_t& byte : image) byte = static_cast<uint8_t>(127.5 * (random() + 1));
  }
  const float mean[] = {100, 120, 90};
  const check::Array<float> first({C, 3, 3, 3}, [&] { return random() / 100; });
  const check::Array<float> second({C, C, 3, 3}, [&] { return random(); });
  const check::Array<float, 1> bias({C}, [&] { return random(); });
  const check::Affine affine(C, random);
  const auto padded = [&](int64_t size) { return (scale * size + multiple - 1) / multiple * multiple; };
  const int64_t H = padded(image_height), W = padded(image_width);
  std::vector<double> expected;
  for (const auto& image : images) {
    std::vector<double> x(3 * H * W), f(C * H * W);
    for (int64_t c = 0; c < 3; ++c) {
      const auto pixel = [&](int64_t y, int64_t column) {
        return static_cast<double>(image[(y * image_width + column) * 3 + c]);
      };
      for (int64_t i = 0; i < H * W; ++i) {
        const auto limited = [&](int64_t at, int64_t size) { return at < scale * size ? at : scale * size - 1; };
        const double ratio = static_cast<double>(scale);
        const check::Linear row = check::half_pixel(limited(i / W, image_height), ratio, image_height);
        const check::Linear column = check::half_pixel(limited(i % W, image_width), ratio, image_width);
        x[c * H * W + i] = check::bilinear(pixel, row, column) - mean[c];
      }
    }
    const auto convolve = [&](const std::vector<double>& in, int64_t channels, const check::Array<float>& weight,
                              int64_t o, int64_t y, int64_t column) {
      double sum = 0;
      for (int64_t c = 0; c < channels; ++c) {
        for (int64_t ky = 0; ky < 3; ++ky) {
          for (int64_t kx = 0; kx < 3; ++kx) {
            const int64_t iy = y + ky - 1, ix = column + kx - 1;
            if (iy < 0 || ix < 0 || iy >= H || ix >= W) continue;
            sum += weight.at(o, c, ky, kx) * in[(c * H + iy) * W + ix];
          }
        }
      }
      return sum;
    };
    for (int64_t c = 0; c < C; ++c) {
      for (int64_t i = 0; i < H * W; ++i) {
        f[c * H * W + i] = std::fmax(0, bias.at(c) + convolve(x, 3, first, c, i / W, i % W));
      }
    }
    for (int64_t c = 0; c < C; ++c) {
      for (int64_t y = 0; y < H / 4; ++y) {
        for (int64_t column = 0; column < W / 4; ++column) {
          double most = -1e30;
          for (int64_t i = 0; i < 4; ++i) {
            most = std::fmax(most, convolve(f, C, second, c, 4 * y + 2 * (i / 2), 4 * column + 2 * (i % 2)));
          }
          expected.push_back(affine(c, most));
        }
      }
    }
  }
  std::vector<float> out(expected.size());
  const Stem<float> args{{images[0].data(), images[1].data()},
                         image_height,
                         image_width,
                         scale,
                         H,
                         W,
                         C,
                         mean,
                         first.view.data,
                         bias.view.data,
                         second.view.data,
                         affine.epilogue(),
                         out.data()};
  stem(isa, args, threads);
  check::near("stem", out, expected);
}

int main() {
  check::for_each_isa([](Isa isa, int threads) {
    for (int64_t scale : {1, 2}) {
      for (int64_t multiple : {4, 16}) {
        test(isa, threads, 1, 1, 1, scale, multiple);
        test(isa, threads, 5, 7, 3, scale, multiple);
        test(isa, threads, 37, 130, 2, scale, multiple);
        test(isa, threads, 16, 64, 1, scale, multiple);
      }
    }
  });
}
