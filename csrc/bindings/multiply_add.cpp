#include "../kernels/multiply_add/multiply_add.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_multiply_add(pybind11::module_& m) {
  m.def("multiply_add", [](Isa isa, int64_t rounds, int threads) {
    Contiguous<float> out(threads);
    int64_t count = 0;
    const MultiplyAdd<float> args{rounds, 0.5f, 0.5f, out.mutable_data(), &count};
    anynet::multiply_add(isa, args, threads);
    return count;
  });
}

const Binding binding(bind_multiply_add);

}  // namespace
}  // namespace anynet::bindings
