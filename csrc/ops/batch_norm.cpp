#include "../kernels/batch_norm/batch_norm.h"

#include <tuple>

#include "backend.h"

namespace anynet::ops {
namespace {

void check_batch_norm(const char* op, const Tensor& input, const Tensor& weight, const Tensor& bias, double eps) {
  ANYNET_CHECK(input.dim() >= 2 && input.size(1) > 0 && input.numel() / input.size(1) > 1, op,
               ": expected input of shape [N, C, ...] with more than one value per channel, got ", shape(input));
  check_tensor(op, "weight", weight, {input.size(1)}, input);
  check_tensor(op, "bias", bias, {input.size(1)}, input);
  ANYNET_CHECK(eps > 0, op, ": expected eps above 0, got ", eps);
}

/// What the CUDA kernels sum in.
Tensor workspace([[maybe_unused]] const Tensor& x) {
  int64_t count = 0;
#ifndef ANYNET_OPS_CPU
  count = cuda::batch_norm_sums(x.size(0), x.size(1), x.numel() / (x.size(0) * x.size(1)));
#endif
  return new_tensor(x, {count}, ScalarType::Double);
}

std::tuple<Tensor, Tensor, Tensor> batch_norm_relu(const Tensor& input, const Tensor& weight, const Tensor& bias,
                                                   double eps) {
  check_batch_norm("batch_norm_relu", input, weight, bias, eps);
  const Tensor x = make_contiguous(input), w = make_contiguous(weight), b = make_contiguous(bias);
  Tensor out = new_like(input), mean = new_like(weight), variance = new_like(weight);
  const Tensor sums = workspace(x);
  dispatch_wide(input.scalar_type(), "batch_norm_relu", [&](auto t) {
    using T = decltype(t);
    const int64_t batch = x.size(0), channels = x.size(1), pixels = x.numel() / (batch * channels);
    const BatchNormRelu<T> args{batch, channels,     pixels,        data<T>(x),        data<T>(w),        data<T>(b),
                                eps,   data<T>(out), data<T>(mean), data<T>(variance), data<double>(sums)};
    ANYNET_RUN(batch_norm_relu, args, x);
  });
  return {out, mean, variance};
}

std::tuple<Tensor, Tensor, Tensor> batch_norm_relu_backward(const Tensor& grad, const Tensor& input,
                                                            const Tensor& weight, const Tensor& bias,
                                                            const Tensor& mean, const Tensor& variance, double eps) {
  const char* op = "batch_norm_relu_backward";
  check_batch_norm(op, input, weight, bias, eps);
  check_tensor(op, "mean", mean, {input.size(1)}, input);
  check_tensor(op, "variance", variance, {input.size(1)}, input);
  check_tensor(op, "grad", grad, input.sizes(), input);
  const Tensor g = make_contiguous(grad), x = make_contiguous(input), w = make_contiguous(weight),
               b = make_contiguous(bias);
  const Tensor m = make_contiguous(mean), v = make_contiguous(variance);
  Tensor grad_input = new_like(input), grad_weight = new_like(weight), grad_bias = new_like(bias);
  const Tensor sums = workspace(x);
  dispatch_wide(input.scalar_type(), op, [&](auto t) {
    using T = decltype(t);
    const int64_t batch = x.size(0), channels = x.size(1), pixels = x.numel() / (batch * channels);
    const BatchNormReluBackward<T> args{batch,
                                        channels,
                                        pixels,
                                        data<T>(g),
                                        data<T>(x),
                                        data<T>(w),
                                        data<T>(b),
                                        data<T>(m),
                                        data<T>(v),
                                        eps,
                                        data<T>(grad_input),
                                        data<T>(grad_weight),
                                        data<T>(grad_bias),
                                        data<double>(sums)};
    ANYNET_RUN(batch_norm_relu_backward, args, x);
  });
  return {grad_input, grad_weight, grad_bias};
}

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  ANYNET_SCHEMA(
      m, "batch_norm_relu(Tensor input, Tensor weight, Tensor bias, float eps=1e-05) -> (Tensor, Tensor, Tensor)");
  ANYNET_SCHEMA(
      m,
      "batch_norm_relu_backward(Tensor grad, Tensor input, Tensor weight, Tensor bias, Tensor mean, Tensor variance, "
      "float eps) -> (Tensor, Tensor, Tensor)");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("batch_norm_relu", TORCH_BOX(&batch_norm_relu));
  m.impl("batch_norm_relu_backward", TORCH_BOX(&batch_norm_relu_backward));
}

}  // namespace anynet::ops
