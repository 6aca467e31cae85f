#include "../kernels/read_image/read_image.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_read_image(pybind11::module_& m) {
  m.def("read_image",
        [](Isa isa, const Contiguous<uint8_t>& image, const Contiguous<float>& mean, const Contiguous<float>& std,
           int64_t factor, int64_t block, int64_t height, int64_t width, int threads) {
          Contiguous<float> out({int64_t{1}, 3 * block * block, height, width});
          const ReadImage<float> args{image.data(), image.shape(0), image.shape(1), factor,     block,
                                      height,       width,          mean.data(),    std.data(), out.mutable_data()};
          anynet::read_image(isa, args, threads);
          return out;
        });
}

const Binding binding(bind_read_image);

}  // namespace
}  // namespace anynet::bindings
