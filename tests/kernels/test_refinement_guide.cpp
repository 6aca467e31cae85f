#include "../../csrc/kernels/read_image/read_image.h"
#include "../../csrc/kernels/refinement_guide/refinement_guide.h"
#include "../../csrc/kernels/warp/warp.h"
#include "check.h"

using namespace anynet;

/// Against the kernels that it does the work of.
void test(Isa isa, int threads, int64_t image_height, int64_t image_width, int64_t factor, int64_t block) {
  check::Random random;
  const int64_t height = (image_height + factor - 1) / factor, width = (image_width + factor - 1) / factor;
  const int64_t plane = height * width;
  std::vector<uint8_t> images[2];
  for (auto& image : images) {
    image.resize(image_height * image_width * 3);
    for (uint8_t& byte : image) byte = static_cast<uint8_t>(127.5 * (random() + 1));
  }
  const float mean[] = {100, 120, 90}, std[] = {50, 60, 55};
  std::vector<float> disparity(plane), scaled(plane);
  for (int64_t i = 0; i < plane; ++i) {
    disparity[i] = static_cast<float>(i % width / 5 * 3 + random());
    scaled[i] = disparity[i] / static_cast<float>(factor);
  }
  const auto read = [&](int side, int64_t by, int64_t blocks) {
    std::vector<float> out(3 * blocks * blocks * plane);
    read_image<float>(
        isa, {images[side].data(), image_height, image_width, by, blocks, height, width, mean, std, out.data()},
        threads);
    return out;
  };
  const std::vector<float> seen = read(0, factor / block, block), left = read(0, factor, 1), right = read(1, factor, 1);
  std::vector<float> warped(3 * plane);
  warp<float>(isa,
              {{right.data(), {1, 3, height, width}, {3 * plane, plane, width, 1}},
               {scaled.data(), {1, 1, height, width}, {plane, plane, width, 1}},
               warped.data()},
              threads);
  std::vector<double> expected(seen.begin(), seen.end());
  for (int64_t i = 0; i < 3 * plane; ++i) expected.push_back(warped[i] - left[i]);
  expected.insert(expected.end(), scaled.begin(), scaled.end());
  std::vector<float> out(expected.size());
  refinement_guide<float>(isa,
                          {{images[0].data(), images[1].data()},
                           image_height,
                           image_width,
                           factor,
                           block,
                           height,
                           width,
                           disparity.data(),
                           mean,
                           std,
                           out.data()},
                          threads);
  check::near("refinement_guide", out, expected);
}

int main() {
  check::for_each_isa([](Isa isa, int threads) {
    for (int64_t factor : {1, 2, 4}) {
      for (int64_t block : {1, 2}) {
        if (block > factor) continue;
        test(isa, threads, 1, 1, factor, block);
        test(isa, threads, 8, 16, factor, block);
        test(isa, threads, 37, 61, factor, block);
        test(isa, threads, 90, 301, factor, block);
      }
    }
  });
}
