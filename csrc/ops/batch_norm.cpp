#include "../kernels/batch_norm/batch_norm.h"

#include <tuple>

#include "tensor.h"

namespace anynet::ops {
namespace {

void check_batch_norm(const char* op, const Tensor& input, const Tensor& weight, const Tensor& bias) {
  ANYNET_CHECK(input.dim() >= 2 && input.size(1) > 0 && input.numel() / input.size(1) > 1, op,
               ": expected input of shape [N, C, ...] with more than one value per channel, got ", shape(input));
  check_tensor(op, "weight", weight, {input.size(1)}, input);
  check_tensor(op, "bias", bias, {input.size(1)}, input);
}

using torch::stable::contiguous;

std::tuple<Tensor, Tensor, Tensor> batch_norm_relu(const Tensor& input, const Tensor& weight, const Tensor& bias,
                                                   double eps) {
  check_batch_norm("batch_norm_relu", input, weight, bias);
  const Tensor x = contiguous(input), w = contiguous(weight), b = contiguous(bias);
  Tensor out = contiguous_like(input), mean = contiguous_like(weight), variance = contiguous_like(weight);
  dispatch_wide(input.scalar_type(), "batch_norm_relu", [&](auto t) {
    using T = decltype(t);
    const int64_t batch = x.size(0), channels = x.size(1);
    const BatchNormRelu<T> args{batch,
                                channels,
                                x.numel() / (batch * channels),
                                data<T>(x),
                                data<T>(w),
                                data<T>(b),
                                eps,
                                data<T>(out),
                                data<T>(mean),
                                data<T>(variance)};
    anynet::batch_norm_relu(chosen_isa(), args, num_threads());
  });
  return {out, mean, variance};
}

std::tuple<Tensor, Tensor, Tensor> batch_norm_relu_backward(const Tensor& grad, const Tensor& input,
                                                            const Tensor& weight, const Tensor& bias,
                                                            const Tensor& mean, const Tensor& variance, double eps) {
  const char* op = "batch_norm_relu_backward";
  check_batch_norm(op, input, weight, bias);
  check_tensor(op, "mean", mean, {input.size(1)}, input);
  check_tensor(op, "variance", variance, {input.size(1)}, input);
  ANYNET_CHECK(shape(grad) == shape(input) && grad.scalar_type() == input.scalar_type(), op,
               ": expected grad of input's shape and dtype, got ", shape(grad));
  const Tensor g = contiguous(grad), x = contiguous(input), w = contiguous(weight), b = contiguous(bias);
  const Tensor m = contiguous(mean), v = contiguous(variance);
  Tensor grad_input = contiguous_like(input), grad_weight = contiguous_like(weight), grad_bias = contiguous_like(bias);
  dispatch_wide(input.scalar_type(), op, [&](auto t) {
    using T = decltype(t);
    const int64_t batch = x.size(0), channels = x.size(1);
    const BatchNormReluBackward<T> args{batch,
                                        channels,
                                        x.numel() / (batch * channels),
                                        data<T>(g),
                                        data<T>(x),
                                        data<T>(w),
                                        data<T>(b),
                                        data<T>(m),
                                        data<T>(v),
                                        eps,
                                        data<T>(grad_input),
                                        data<T>(grad_weight),
                                        data<T>(grad_bias)};
    anynet::batch_norm_relu_backward(chosen_isa(), args, num_threads());
  });
  return {grad_input, grad_weight, grad_bias};
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  ANYNET_SCHEMA(
      m, "batch_norm_relu(Tensor input, Tensor weight, Tensor bias, float eps=1e-05) -> (Tensor, Tensor, Tensor)");
  ANYNET_SCHEMA(
      m,
      "batch_norm_relu_backward(Tensor grad, Tensor input, Tensor weight, Tensor bias, Tensor mean, Tensor variance, "
      "float eps) -> (Tensor, Tensor, Tensor)");
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) {
  m.impl("batch_norm_relu", TORCH_BOX(&batch_norm_relu));
  m.impl("batch_norm_relu_backward", TORCH_BOX(&batch_norm_relu_backward));
}

}  // namespace anynet::ops
