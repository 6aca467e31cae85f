#include "../kernels/cost_volume/cost_volume.h"

#include <pybind11/stl.h>

#include <optional>

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_cost_volume(pybind11::module_& module) {
  for_each_type(module, [](pybind11::module_& m, auto type) {
    using T = decltype(type);
    using Optional = std::optional<Array<T>>;
    m.def("cost_volume", [](Isa isa, const Array<T>& left, const Array<T>& right, const Optional& disparity,
                            int64_t first, int64_t last, int threads) {
      const int64_t count = last - first + 1;
      Array<T> out({left.shape(0), count, left.shape(2), left.shape(3)});
      const CostVolume<T> args{view<T>(left), view<T>(right), disparity ? view<T>(*disparity) : View4<const T>{},
                               first,         count,          out.mutable_data()};
      anynet::cost_volume(isa, args, threads);
      return out;
    });
    m.def("cost_volume_backward", [](Isa isa, const Array<T>& grad, const Array<T>& left, const Array<T>& right,
                                     const Optional& disparity, int64_t first, int64_t last, int threads) {
      Array<T> grad_left = empty_like(left), grad_right = empty_like(right);
      Optional grad_disparity;
      if (disparity) grad_disparity = empty_like(*disparity);
      const CostVolumeBackward<T> args{view<T>(grad),
                                       view<T>(left),
                                       view<T>(right),
                                       disparity ? view<T>(*disparity) : View4<const T>{},
                                       first,
                                       last - first + 1,
                                       grad_left.mutable_data(),
                                       grad_right.mutable_data(),
                                       disparity ? grad_disparity->mutable_data() : nullptr};
      anynet::cost_volume_backward(isa, args, threads);
      return pybind11::make_tuple(grad_left, grad_right, grad_disparity);
    });
  });
  module.def("cost_volume_affine_relu",
             [](Isa isa, const Contiguous<float>& left, const Contiguous<float>& right,
                const std::optional<Contiguous<float>>& disparity, int64_t first, int64_t last,
                const Contiguous<float>& scale, const Contiguous<float>& shift, int threads) {
               const int64_t count = last - first + 1;
               Contiguous<float> out({left.shape(0), count, left.shape(2), left.shape(3)});
               const CostVolume<float> args{view<float>(left),
                                            view<float>(right),
                                            disparity ? view<float>(*disparity) : View4<const float>{},
                                            first,
                                            count,
                                            out.mutable_data(),
                                            affine_relu(scale, shift)};
               anynet::cost_volume(isa, args, threads);
               return out;
             });
}

const Binding binding(bind_cost_volume);

}  // namespace
}  // namespace anynet::bindings
