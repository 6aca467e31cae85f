#include "../kernels/occlusion/occlusion.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_occlusion(pybind11::module_& m) {
  m.def("fill_occlusions", [](Isa isa, const Contiguous<float>& disparity, float pixel, int threads) {
    Contiguous<float> out = empty_like<float>(disparity);
    const int64_t width = disparity.shape(3);
    anynet::fill_occlusions(
        isa, FillOcclusions<float>{disparity.size() / width, width, disparity.data(), pixel, out.mutable_data()},
        threads);
    return out;
  });
}

const Binding binding(bind_occlusion);

}  // namespace
}  // namespace anynet::bindings
