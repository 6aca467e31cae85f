#include "../kernels/upsample/upsample.h"

#include <pybind11/stl.h>

#include <vector>

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_upsample(pybind11::module_& m) {
  m.def("upsample_sum", [](Isa isa, const std::vector<Contiguous<float>>& maps, const std::vector<int64_t>& ratios,
                           const std::vector<float>& gains, float side, int64_t height, int64_t width, int threads) {
    Contiguous<float> out({height, width});
    UpsampleSum<float> args{};
    args.count = static_cast<int>(maps.size());
    for (size_t i = 0; i < maps.size(); ++i) {
      args.map[i] = maps[i].data();
      args.height[i] = maps[i].shape(0);
      args.width[i] = maps[i].shape(1);
      args.ratio[i] = ratios[i];
      args.gain[i] = gains[i];
    }
    args.side = side;
    args.out_height = height;
    args.out_width = width;
    args.out = out.mutable_data();
    anynet::upsample_sum(isa, args, threads);
    return out;
  });
  m.def("upsample_concat", [](Isa isa, const Contiguous<float>& skip, const Contiguous<float>& coarse,
                              const Contiguous<float>& scale, const Contiguous<float>& shift, int threads) {
    Contiguous<float> out({skip.shape(0), skip.shape(1) + coarse.shape(1), skip.shape(2), skip.shape(3)});
    const UpsampleConcat<float> args{
        skip.shape(0),     skip.shape(1),   coarse.shape(1), skip.shape(2), skip.shape(3),
        coarse.shape(2),   coarse.shape(3), skip.data(),     coarse.data(), affine_relu(scale, shift),
        out.mutable_data()};
    anynet::upsample_concat(isa, args, threads);
    return out;
  });
  m.def("upsample_add", [](Isa isa, const Contiguous<float>& input, const Contiguous<float>& coarse,
                           const Contiguous<float>& scale, const Contiguous<float>& shift, int threads) {
    Contiguous<float> out = empty_like<float>(input);
    const UpsampleAdd<float> args{input.shape(0),
                                  input.shape(1),
                                  input.shape(2),
                                  input.shape(3),
                                  input.shape(4),
                                  coarse.shape(2),
                                  coarse.shape(3),
                                  coarse.shape(4),
                                  input.data(),
                                  coarse.data(),
                                  affine_relu(scale, shift),
                                  out.mutable_data()};
    anynet::upsample_add(isa, args, threads);
    return out;
  });
}

const Binding binding(bind_upsample);

}  // namespace
}  // namespace anynet::bindings
