#include "../kernels/conv/conv.h"

#include <pybind11/stl.h>

#include <optional>
#include <vector>

#include "bindings.h"

namespace anynet::bindings {
namespace {

/// The shape of a convolution of `sizes` ([N,C,D,H,W]) with `weight` ([O,C,kd,3,3]).
ConvShape conv_shape(const std::vector<int64_t>& sizes, int64_t out_channels, int64_t kernel_depth, int64_t stride) {
  if (sizes.size() != 5) throw std::invalid_argument("expected an input of 5 dimensions");
  return {sizes[0], sizes[1], out_channels, sizes[2], sizes[3], sizes[4], kernel_depth, stride};
}

template <class T>
void bind(pybind11::module_& m) {
  using Array = pybind11::array_t<T, pybind11::array::c_style>;
  const auto data = [](const std::optional<Array>& a) { return a ? a->data() : nullptr; };
  m.def("conv", [=](Isa isa, const Array& input, const Array& weight, const std::optional<Array>& bias,
                    const std::optional<Array>& scale, const std::optional<Array>& shift, int64_t stride, bool relu_in,
                    bool relu_out, int threads) {
    const std::vector<int64_t> sizes(input.shape(), input.shape() + input.ndim());
    const ConvShape shape = conv_shape(sizes, weight.shape(0), weight.shape(2), stride);
    const int64_t depth_stride = shape.kernel_depth == 1 ? 1 : stride;
    Array out({shape.batch, shape.out_channels, (shape.depth - 1) / depth_stride + 1, (shape.height - 1) / stride + 1,
               (shape.width - 1) / stride + 1});
    anynet::conv(isa,
                 Conv<T>{shape, input.data(), weight.data(), data(bias), data(scale), data(shift), relu_in, relu_out,
                         out.mutable_data()},
                 threads);
    return out;
  });
  m.def("conv_backward_input", [=](Isa isa, const Array& grad, const Array& weight, const std::optional<Array>& before,
                                   const std::vector<int64_t>& sizes, int64_t stride, int threads) {
    const ConvShape shape = conv_shape(sizes, weight.shape(0), weight.shape(2), stride);
    Array grad_input(sizes);
    anynet::conv_backward_input(
        isa, ConvBackwardInput<T>{shape, grad.data(), weight.data(), data(before), grad_input.mutable_data()}, threads);
    return grad_input;
  });
  m.def("conv_backward_weight", [=](Isa isa, const Array& grad, const Array& input, const std::optional<Array>& scale,
                                    const std::optional<Array>& shift, int64_t kernel_depth, int64_t stride,
                                    bool relu_in, int threads) {
    const std::vector<int64_t> sizes(input.shape(), input.shape() + input.ndim());
    const ConvShape shape = conv_shape(sizes, grad.shape(1), kernel_depth, stride);
    Array grad_weight({shape.out_channels, shape.in_channels, kernel_depth, int64_t{3}, int64_t{3}});
    Array grad_bias({shape.out_channels});
    anynet::conv_backward_weight(isa,
                                 ConvBackwardWeight<T>{shape, grad.data(), input.data(), data(scale), data(shift),
                                                       relu_in, grad_weight.mutable_data(), grad_bias.mutable_data()},
                                 threads);
    return pybind11::make_tuple(grad_weight, grad_bias);
  });
}

void bind_conv(pybind11::module_& m) {
  bind<float>(m);
  bind<double>(m);
}

const Binding binding(bind_conv);

}  // namespace
}  // namespace anynet::bindings
