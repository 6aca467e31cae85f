#include <algorithm>

#include "../common/parallel.h"
#include "../common/sampling.h"
#include "../read_image/reader.h"
#include "refinement_guide.h"

namespace anynet::ANYNET_ISA {

template <class T>
void refinement_guide(const RefinementGuide<T>& a, int threads) {
  const auto reader = [&](int side, int64_t factor, int64_t block) {
    return Reader<T>(
        {a.image[side], a.image_height, a.image_width, factor, block, a.height, a.width, a.mean, a.std, nullptr});
  };
  const Reader<T> seen = reader(0, a.factor / a.block, a.block), left = reader(0, a.factor, 1),
                  right = reader(1, a.factor, 1);
  const int64_t W = a.width, plane = a.height * W, shown = 3 * a.block * a.block;
  const int64_t pitch = round_up(W, lanes<T>) + 2 * sampled_beside<T>;
  parallel_ranges(a.height, useful_threads(threads, plane, shown, 10), [&](int64_t begin, int64_t end) {
    const Scratch<T> left_rows(3, pitch), right_rows(3, pitch);
    fill_zero<T>(right_rows, 3 * pitch);
    Positions<T> at(W);
    for (int64_t y = begin; y < end; ++y) {
      T *const out = a.out + y * W, *const difference = out + shown * plane, *const disparity = difference + 3 * plane;
      for (int64_t x = 0; x < W; ++x) disparity[x] = a.disparity[y * W + x] / static_cast<T>(a.factor);
      at.read(disparity, 1, 0, -2, static_cast<int32_t>(W));
      seen.row(y, out, plane);
      left.row(y, left_rows, pitch);
      right.row(y, right_rows + sampled_beside<T>, pitch);
      for (int64_t x = 0; x < W; x += lanes<T>) {
        gather_at(at, x, [&](const auto& gather) {
          const vec<T> f = load(at.fraction + x);
          for (int64_t c = 0; c < 3; ++c) {
            vec<T> sides[2];
            gather.template descending<2>(right_rows + c * pitch + sampled_beside<T>, 1, sides);
            const vec<T> warped = (1 - f) * sides[1] + f * sides[0];
            write_vector<T>(warped - load(left_rows + c * pitch + x), std::min<int64_t>(W - x, lanes<T>),
                            difference + c * plane + x);
          }
        });
      }
    }
  });
}

template void refinement_guide<float>(const RefinementGuide<float>&, int);

}  // namespace anynet::ANYNET_ISA
