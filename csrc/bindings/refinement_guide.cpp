#include "../kernels/refinement_guide/refinement_guide.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_refinement_guide(pybind11::module_& m) {
  m.def("refinement_guide", [](Isa isa, const Contiguous<uint8_t>& left, const Contiguous<uint8_t>& right,
                               const Contiguous<float>& disparity, const Contiguous<float>& mean,
                               const Contiguous<float>& std, int64_t factor, int64_t block, int threads) {
    const int64_t height = disparity.shape(2), width = disparity.shape(3);
    Contiguous<float> out({int64_t{1}, 3 * block * block + 4, height, width});
    const RefinementGuide<float> args{{left.data(), right.data()},
                                      left.shape(0),
                                      left.shape(1),
                                      factor,
                                      block,
                                      height,
                                      width,
                                      disparity.data(),
                                      mean.data(),
                                      std.data(),
                                      out.mutable_data()};
    anynet::refinement_guide(isa, args, threads);
    return out;
  });
}

const Binding binding(bind_refinement_guide);

}  // namespace
}  // namespace anynet::bindings
