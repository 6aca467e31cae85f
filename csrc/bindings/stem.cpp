#include "../kernels/stem/stem.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_stem(pybind11::module_& m) {
  m.def("stem",
        [](Isa isa, const Contiguous<uint8_t>& left, const Contiguous<uint8_t>& right, const Contiguous<float>& mean,
           const Contiguous<float>& weight_first, const Contiguous<float>& bias_first,
           const Contiguous<float>& weight_second, const Contiguous<float>& scale, const Contiguous<float>& shift,
           int64_t input_scale, int64_t multiple, int threads) {
          const auto padded = [&](int64_t size) { return (input_scale * size + multiple - 1) / multiple * multiple; };
          const int64_t height = padded(left.shape(0)), width = padded(left.shape(1)), channels = bias_first.size();
          Contiguous<float> out({int64_t{2}, channels, height / 4, width / 4});
          const Stem<float> args{{left.data(), right.data()},
                                 left.shape(0),
                                 left.shape(1),
                                 input_scale,
                                 height,
                                 width,
                                 channels,
                                 mean.data(),
                                 weight_first.data(),
                                 bias_first.data(),
                                 weight_second.data(),
                                 affine_relu(scale, shift),
                                 out.mutable_data()};
          anynet::stem(isa, args, threads);
          return out;
        });
}

const Binding binding(bind_stem);

}  // namespace
}  // namespace anynet::bindings
