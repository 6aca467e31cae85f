#include "../kernels/batch_norm/batch_norm.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

template <class T>
void bind(pybind11::module_& m) {
  using Array = pybind11::array_t<T, pybind11::array::c_style>;
  m.def("batch_norm_relu", [](Isa isa, const Array& input, const Array& weight, const Array& bias, double eps,
                              int threads) {
    const int64_t batch = input.shape(0), channels = input.shape(1);
    Array out({input.shape(0), input.shape(1), input.shape(2)}), mean(channels), variance(channels);
    anynet::batch_norm_relu(isa,
                            BatchNormRelu<T>{batch, channels, input.shape(2), input.data(), weight.data(), bias.data(),
                                             eps, out.mutable_data(), mean.mutable_data(), variance.mutable_data()},
                            threads);
    return std::tuple(out, mean, variance);
  });
  m.def("batch_norm_relu_backward", [](Isa isa, const Array& grad, const Array& input, const Array& weight,
                                       const Array& bias, const Array& mean, const Array& variance, double eps,
                                       int threads) {
    const int64_t batch = input.shape(0), channels = input.shape(1);
    Array grad_input({input.shape(0), input.shape(1), input.shape(2)}), grad_weight(channels), grad_bias(channels);
    anynet::batch_norm_relu_backward(
        isa,
        BatchNormReluBackward<T>{batch, channels, input.shape(2), grad.data(), input.data(), weight.data(), bias.data(),
                                 mean.data(), variance.data(), eps, grad_input.mutable_data(),
                                 grad_weight.mutable_data(), grad_bias.mutable_data()},
        threads);
    return std::tuple(grad_input, grad_weight, grad_bias);
  });
}

void bind_batch_norm(pybind11::module_& m) {
  bind<float>(m);
  bind<double>(m);
}

const Binding binding(bind_batch_norm);

}  // namespace
}  // namespace anynet::bindings
