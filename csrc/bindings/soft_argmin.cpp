#include "../kernels/soft_argmin/soft_argmin.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_soft_argmin(pybind11::module_& module) {
  for_each_type(module, [](pybind11::module_& m, auto type) {
    using T = decltype(type);
    m.def("soft_argmin", [](Isa isa, const Array<T>& cost, int64_t first, int threads) {
      Array<T> out({cost.shape(0), pybind11::ssize_t{1}, cost.shape(2), cost.shape(3)});
      const SoftArgmin<T> args{view<T>(cost), first, out.mutable_data()};
      anynet::soft_argmin(isa, args, threads);
      return out;
    });
    m.def("soft_argmin_backward", [](Isa isa, const Array<T>& grad, const Array<T>& cost, int64_t first, int threads) {
      Array<T> grad_cost = empty_like(cost);
      const SoftArgminBackward<T> args{view<T>(grad), view<T>(cost), first, grad_cost.mutable_data()};
      anynet::soft_argmin_backward(isa, args, threads);
      return grad_cost;
    });
  });
}

const Binding binding(bind_soft_argmin);

}  // namespace
}  // namespace anynet::bindings
