#include "../kernels/max_pool/max_pool.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_max_pool(pybind11::module_& m) {
  m.def("max_pool", [](Isa isa, const Contiguous<float>& input, const Contiguous<float>& scale,
                       const Contiguous<float>& shift, int threads) {
    Contiguous<float> out({input.shape(0), input.shape(1), input.shape(2) / 2, input.shape(3) / 2});
    const MaxPool<float> args{input.shape(0),    input.shape(1), input.shape(2),
                              input.shape(3),    input.data(),   affine_relu(scale, shift),
                              out.mutable_data()};
    anynet::max_pool(isa, args, threads);
    return out;
  });
}

const Binding binding(bind_max_pool);

}  // namespace
}  // namespace anynet::bindings
