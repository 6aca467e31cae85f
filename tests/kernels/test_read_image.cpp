#include "../../csrc/kernels/read_image/read_image.h"
#include "check.h"

using namespace anynet;

void test(Isa isa, int threads, int64_t image_height, int64_t image_width, int64_t factor, int64_t block) {
  check::Random random;
  std::vector<uint8_t> image(image_height * image_width * 3);
  for (uint8_t& byte : image) byte = static_cast<uint8_t>(127.5 * (random() + 1));
  const float mean[] = {100, 120, 90}, std[] = {50, 60, 55};
  const int64_t step = factor * block;
  const int64_t height = (image_height + step - 1) / step, width = (image_width + step - 1) / step;
  std::vector<double> expected;
  for (int64_t c = 0; c < 3; ++c) {
    const auto pixel = [&](int64_t y, int64_t x) {
      y = y < image_height ? y : image_height - 1;
      x = x < image_width ? x : image_width - 1;
      return static_cast<double>(image[(y * image_width + x) * 3 + c]);
    };
    for (int64_t i = 0; i < block; ++i) {
      for (int64_t j = 0; j < block; ++j) {
        for (int64_t y = 0; y < height; ++y) {
          for (int64_t x = 0; x < width; ++x) {
            const double ratio = 1 / static_cast<double>(factor);
            const check::Linear row = check::half_pixel(block * y + i, ratio, factor * block * height);
            const check::Linear column = check::half_pixel(block * x + j, ratio, factor * block * width);
            expected.push_back((check::bilinear(pixel, row, column) - mean[c]) / std[c]);
          }
        }
      }
    }
  }
  std::vector<float> out(expected.size());
  const ReadImage<float> args{image.data(), image_height, image_width, factor, block,
                              height,       width,        mean,        std,    out.data()};
  read_image(isa, args, threads);
  check::near("read_image", out, expected);
}

int main() {
  check::for_each_isa([](Isa isa, int threads) {
    for (int64_t factor : {1, 2, 4}) {
      for (int64_t block : {1, 2}) {
        test(isa, threads, 1, 1, factor, block);
        test(isa, threads, 8, 16, factor, block);
        test(isa, threads, 37, 61, factor, block);
        test(isa, threads, 90, 301, factor, block);
      }
    }
  });
}
