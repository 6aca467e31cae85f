#include "../kernels/soft_argmin/soft_argmin.h"

#include "bindings.h"

namespace anynet::bindings {

template <class T>
void bind(pybind11::module_& m) {
  using Array = pybind11::array_t<T>;
  m.def("soft_argmin", [](Isa isa, const Array& cost, int64_t first, int threads) {
    Array out({cost.shape(0), pybind11::ssize_t{1}, cost.shape(2), cost.shape(3)});
    const SoftArgmin<T> args{view<T>(cost), first, out.mutable_data()};
    anynet::soft_argmin(isa, args, threads);
    return out;
  });
}

void bind_soft_argmin(pybind11::module_& m) {
  bind<float>(m);
  bind<double>(m);
}

}  // namespace anynet::bindings
