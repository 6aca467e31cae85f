#include "../kernels/convex_upsampling/convex_upsampling.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_convex_upsampling(pybind11::module_& m) {
  m.def("convex_upsampling", [](Isa isa, const Contiguous<float>& input, const Contiguous<float>& logits, int threads) {
    Contiguous<float> out({input.shape(0), pybind11::ssize_t{1}, 2 * input.shape(2), 2 * input.shape(3)});
    anynet::convex_upsampling(isa,
                              ConvexUpsampling<float>{input.shape(0), input.shape(2), input.shape(3), input.data(),
                                                      logits.data(), out.mutable_data()},
                              threads);
    return out;
  });
}

const Binding binding(bind_convex_upsampling);

}  // namespace
}  // namespace anynet::bindings
