#include "conv.h"

#include <optional>
#include <tuple>
#include <vector>

namespace anynet::ops {
namespace {

using torch::stable::contiguous;

Tensor new_tensor(const Tensor& like, const std::vector<int64_t>& sizes) {
  return torch::stable::new_empty(like, torch::headeronly::IntHeaderOnlyArrayRef(sizes));
}

template <class T>
const T* data(const std::optional<Tensor>& t) {
  return t ? static_cast<const T*>(t->const_data_ptr()) : nullptr;
}

std::optional<Tensor> contiguous_or_none(const std::optional<Tensor>& t) {
  return t ? std::optional<Tensor>(contiguous(*t)) : std::nullopt;
}

template <int64_t dimensions>
Tensor conv(const Tensor& input, const Tensor& weight, std::optional<Tensor> bias, std::optional<Tensor> scale,
            std::optional<Tensor> shift, int64_t stride, bool relu_in, bool relu_out) {
  const ScalarType dtype = input.scalar_type();
  check_conv_input(input, dimensions, stride);
  check_conv_weight(weight, dimensions, input.size(1));
  ANYNET_CHECK(weight.scalar_type() == dtype, conv_name(dimensions), ": input and weight must have one dtype");
  check_conv_vector(bias, "bias", dimensions, weight.size(0), dtype);
  check_conv_vector(scale, "scale", dimensions, input.size(1), dtype);
  check_conv_vector(shift, "shift", dimensions, input.size(1), dtype);
  ANYNET_CHECK(scale.has_value() == shift.has_value(), conv_name(dimensions),
               ": expected both or none of scale and shift");
  const Tensor x = contiguous(input), w = contiguous(weight);
  const auto b = contiguous_or_none(bias), s = contiguous_or_none(scale), t = contiguous_or_none(shift);
  Tensor out = new_tensor(input, conv_out_sizes(sizes(input), weight.size(0), stride));
  dispatch_wide(dtype, conv_name(dimensions), [&](auto element) {
    using T = decltype(element);
    const Conv<T> args{conv_shape(sizes(input), weight.size(0), stride),
                       data<T>(x),
                       data<T>(w),
                       data<T>(b),
                       data<T>(s),
                       data<T>(t),
                       relu_in,
                       relu_out,
                       static_cast<T*>(out.mutable_data_ptr())};
    anynet::conv(chosen_isa(), args, num_threads());
  });
  return out;
}

template <int64_t dimensions>
Tensor conv_backward_input(const Tensor& grad, const Tensor& weight, std::optional<Tensor> before,
                           std::vector<int64_t> input_size, int64_t stride) {
  Tensor grad_input = new_tensor(grad, input_size);
  check_conv_input(grad_input, dimensions, stride);
  check_conv_weight(weight, dimensions, input_size[1]);
  ANYNET_CHECK(
      sizes(grad) == conv_out_sizes(input_size, weight.size(0), stride) && grad.scalar_type() == weight.scalar_type(),
      conv_name(dimensions), ": expected grad of the output's shape and dtype, got ", shape(grad));
  ANYNET_CHECK(!before || (sizes(*before) == input_size && before->scalar_type() == grad.scalar_type()),
               conv_name(dimensions), ": expected before of the input's shape and dtype, got ", shape(*before));
  const Tensor g = contiguous(grad), w = contiguous(weight);
  const auto x = contiguous_or_none(before);
  dispatch_wide(grad.scalar_type(), conv_name(dimensions), [&](auto element) {
    using T = decltype(element);
    const ConvBackwardInput<T> args{conv_shape(input_size, weight.size(0), stride), data<T>(g), data<T>(w), data<T>(x),
                                    static_cast<T*>(grad_input.mutable_data_ptr())};
    anynet::conv_backward_input(chosen_isa(), args, num_threads());
  });
  return grad_input;
}

template <int64_t dimensions>
std::tuple<Tensor, Tensor> conv_backward_weight(const Tensor& grad, const Tensor& input, std::optional<Tensor> scale,
                                                std::optional<Tensor> shift, int64_t stride, bool relu_in) {
  check_conv_input(input, dimensions, stride);
  ANYNET_CHECK(grad.dim() == input.dim() && grad.size(1) <= conv_channels &&
                   sizes(grad) == conv_out_sizes(sizes(input), grad.size(1), stride) &&
                   grad.scalar_type() == input.scalar_type(),
               conv_name(dimensions), ": expected grad of the output's shape and dtype for input ", shape(input),
               ", got ", shape(grad));
  check_conv_vector(scale, "scale", dimensions, input.size(1), input.scalar_type());
  check_conv_vector(shift, "shift", dimensions, input.size(1), input.scalar_type());
  ANYNET_CHECK(scale.has_value() == shift.has_value(), conv_name(dimensions),
               ": expected both or none of scale and shift");
  const Tensor g = contiguous(grad), x = contiguous(input);
  const auto s = contiguous_or_none(scale), t = contiguous_or_none(shift);
  std::vector<int64_t> weight_sizes(input.dim(), 3);
  weight_sizes[0] = grad.size(1), weight_sizes[1] = input.size(1);
  Tensor grad_weight = new_tensor(grad, weight_sizes), grad_bias = new_tensor(grad, {grad.size(1)});
  dispatch_wide(grad.scalar_type(), conv_name(dimensions), [&](auto element) {
    using T = decltype(element);
    const ConvBackwardWeight<T> args{conv_shape(sizes(input), grad.size(1), stride),
                                     data<T>(g),
                                     data<T>(x),
                                     data<T>(s),
                                     data<T>(t),
                                     relu_in,
                                     static_cast<T*>(grad_weight.mutable_data_ptr()),
                                     static_cast<T*>(grad_bias.mutable_data_ptr())};
    anynet::conv_backward_weight(chosen_isa(), args, num_threads());
  });
  return {grad_weight, grad_bias};
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(anynet, m) {
  for (const std::string name : {"conv3x3", "conv3x3x3"}) {
    m.def((name + "(Tensor input, Tensor weight, Tensor? bias, Tensor? scale, Tensor? shift, int stride, bool relu_in, "
                  "bool relu_out) -> Tensor")
              .c_str());
    m.def((name +
           "_backward_input(Tensor grad, Tensor weight, Tensor? before, SymInt[] input_size, int stride) -> Tensor")
              .c_str());
    m.def((name + "_backward_weight(Tensor grad, Tensor input, Tensor? scale, Tensor? shift, int stride, bool relu_in) "
                  "-> (Tensor, Tensor)")
              .c_str());
  }
}

STABLE_TORCH_LIBRARY_IMPL(anynet, CPU, m) {
  m.impl("conv3x3", TORCH_BOX(&conv<2>));
  m.impl("conv3x3_backward_input", TORCH_BOX(&conv_backward_input<2>));
  m.impl("conv3x3_backward_weight", TORCH_BOX(&conv_backward_weight<2>));
  m.impl("conv3x3x3", TORCH_BOX(&conv<3>));
  m.impl("conv3x3x3_backward_input", TORCH_BOX(&conv_backward_input<3>));
  m.impl("conv3x3x3_backward_weight", TORCH_BOX(&conv_backward_weight<3>));
}

}  // namespace anynet::ops
