#include "../kernels/conv/conv.h"

#include <optional>
#include <tuple>
#include <vector>

#include "backend.h"

namespace anynet::ops {
namespace {

constexpr int64_t conv_channels = 64;  // the most that the operators take, in and out

/// "conv3x3" or "conv3x3x3", for messages.
const char* conv_name(int64_t dimensions) { return dimensions == 2 ? "conv3x3" : "conv3x3x3"; }

bool is_conv_kernel(const Tensor& weight, int64_t dimensions) {
  if (weight.dim() != dimensions + 2) return false;
  for (int64_t i = 2; i < weight.dim(); ++i) {
    if (weight.size(i) != 3) return false;
  }
  return weight.size(0) >= 1 && weight.size(0) <= conv_channels && weight.size(1) >= 1 &&
         weight.size(1) <= conv_channels;
}

/// The shape for an input of `sizes` ([N,C,(D,)H,W]) and `out_channels`.
ConvShape conv_shape(const std::vector<int64_t>& sizes, int64_t out_channels, int64_t stride) {
  const bool volume = sizes.size() == 5;
  return {sizes[0],     sizes[1],       out_channels, volume ? sizes[2] : 1, sizes[sizes.size() - 2],
          sizes.back(), volume ? 3 : 1, stride};
}

std::vector<int64_t> sizes(const Tensor& t) {
  std::vector<int64_t> result;
  for (int64_t i = 0; i < t.dim(); ++i) result.push_back(t.size(i));
  return result;
}

/// [N,O,(D',)H',W']
std::vector<int64_t> conv_out_sizes(const std::vector<int64_t>& sizes, int64_t out_channels, int64_t stride) {
  std::vector<int64_t> result{sizes[0], out_channels};
  for (size_t i = 2; i < sizes.size(); ++i) result.push_back((sizes[i] - 1) / stride + 1);
  return result;
}

void check_conv_input(const char* op, const std::vector<int64_t>& input, int64_t dimensions, int64_t stride) {
  bool sized = static_cast<int64_t>(input.size()) == dimensions + 2 && input[0] >= 0 && input[1] >= 1 &&
               input[1] <= conv_channels;
  for (size_t i = 2; sized && i < input.size(); ++i) sized = input[i] >= 1;
  ANYNET_CHECK(sized, op, ": expected input of shape [N, C, ", dimensions == 3 ? "D, " : "", "H, W] with C in 1..",
               conv_channels, " and at least one pixel, got ", shape(input));
  ANYNET_CHECK(stride == 1 || stride == 2, op, ": expected stride 1 or 2, got ", stride);
}

void check_conv_weight(const char* op, const char* name, const Tensor& weight, int64_t dimensions,
                       int64_t in_channels) {
  ANYNET_CHECK(is_conv_kernel(weight, dimensions) && weight.size(1) == in_channels, op, ": expected ", name,
               " of shape [O, ", in_channels, dimensions == 3 ? ", 3, 3, 3" : ", 3, 3", "] with O in 1..",
               conv_channels, ", got ", shape(weight));
}

void check_conv_vector(const char* op, const char* name, const std::optional<Tensor>& vector, int64_t channels,
                       const Tensor& input) {
  if (!vector) return;
  ANYNET_CHECK(vector->dim() == 1 && vector->size(0) == channels && vector->scalar_type() == input.scalar_type(), op,
               ": expected ", name, " as ", dtype_name(input.scalar_type()), " [", channels, "], got ",
               described(*vector));
  check_device(op, name, *vector, input);
}

template <class T>
const T* data(const std::optional<Tensor>& t) {
  return t ? static_cast<const T*>(t->const_data_ptr()) : nullptr;
}

std::optional<Tensor> contiguous_or_none(const std::optional<Tensor>& t) {
  return t ? std::optional<Tensor>(make_contiguous(*t)) : std::nullopt;
}

/// Of arguments that have been checked.
Tensor convolve(const char* op, const Tensor& input, const Tensor& weight, const std::optional<Tensor>& bias,
                const std::optional<Tensor>& scale, const std::optional<Tensor>& shift, int64_t stride, bool relu_in,
                bool relu_out) {
  const Tensor x = make_contiguous(input), w = make_contiguous(weight);
  const auto b = contiguous_or_none(bias), s = contiguous_or_none(scale), t = contiguous_or_none(shift);
  Tensor out = new_tensor(input, conv_out_sizes(sizes(input), weight.size(0), stride));
  dispatch_wide(input.scalar_type(), op, [&](auto element) {
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
    ANYNET_RUN(conv, args, input);
  });
  return out;
}

template <int64_t dimensions>
Tensor conv(const Tensor& input, const Tensor& weight, std::optional<Tensor> bias, std::optional<Tensor> scale,
            std::optional<Tensor> shift, int64_t stride, bool relu_in, bool relu_out) {
  const char* op = conv_name(dimensions);
  check_conv_input(op, sizes(input), dimensions, stride);
  check_conv_weight(op, "weight", weight, dimensions, input.size(1));
  ANYNET_CHECK(weight.scalar_type() == input.scalar_type(), op, ": expected input and weight of one dtype, got ",
               dtype_name(input.scalar_type()), " and ", dtype_name(weight.scalar_type()));
  check_device(op, "weight", weight, input);
  check_conv_vector(op, "bias", bias, weight.size(0), input);
  check_conv_vector(op, "scale", scale, input.size(1), input);
  check_conv_vector(op, "shift", shift, input.size(1), input);
  ANYNET_CHECK(scale.has_value() == shift.has_value(), op, ": expected both or none of scale and shift");
  return convolve(op, input, weight, bias, scale, shift, stride, relu_in, relu_out);
}

#ifndef ANYNET_OPS_CPU
/// Two layers in one launch, or nothing if they do not fit into one.
std::optional<Tensor> conv_pair(const Tensor& input, const Tensor* weights, const std::optional<Tensor>* biases,
                                bool relu_out) {
  const ConvShape shape = conv_shape(sizes(input), weights[0].size(0), 1);
  if (!cuda::conv_pair_fits(shape)) return std::nullopt;
  Tensor out = new_tensor(input, conv_out_sizes(sizes(input), weights[1].size(0), 1));
  const ConvPair<float> args{shape,
                             weights[1].size(0),
                             const_data<float>(input),
                             const_data<float>(weights[0]),
                             data<float>(biases[0]),
                             const_data<float>(weights[1]),
                             data<float>(biases[1]),
                             relu_out,
                             static_cast<float*>(out.mutable_data_ptr())};
  ANYNET_RUN(conv_pair, args, input);
  return out;
}
#endif

Tensor conv_chain(const Tensor& input, const std::vector<Tensor>& weights,
                  const std::vector<std::optional<Tensor>>& biases, bool relu_out) {
  const char* op = "conv_chain";
  const int64_t dimensions = input.dim() == 5 ? 3 : 2;
  const size_t layers = weights.size();
  ANYNET_CHECK(layers > 0 && biases.size() == layers, op, ": expected at least one weight and as many biases, got ",
               layers, " and ", biases.size());
  check_contiguous(op, "input", input, dimensions + 2);
  check_conv_input(op, sizes(input), dimensions, 1);
  for (size_t i = 0; i < layers; ++i) {
    check_conv_weight(op, "weights", weights[i], dimensions, i == 0 ? input.size(1) : weights[i - 1].size(0));
    check_contiguous(op, "weights", weights[i], dimensions + 2);
    check_device(op, "weights", weights[i], input);
    check_conv_vector(op, "biases", biases[i], weights[i].size(0), input);
    if (biases[i]) check_contiguous(op, "biases", *biases[i], 1);
  }
  Tensor x = input;
  for (size_t i = 0; i < layers; ++i) {
#ifndef ANYNET_OPS_CPU
    if (i + 1 < layers) {
      if (const auto out = conv_pair(x, &weights[i], &biases[i], i + 2 < layers || relu_out)) {
        x = *out;
        ++i;
        continue;
      }
    }
#endif
    x = convolve(op, x, weights[i], biases[i], std::nullopt, std::nullopt, 1, false, i + 1 < layers || relu_out);
  }
  return x;
}

#ifdef ANYNET_OPS_CPU  // on CUDA the derivatives are PyTorch's (anynet_ext/_conv.py)
template <int64_t dimensions>
Tensor conv_backward_input(const Tensor& grad, const Tensor& weight, std::optional<Tensor> before,
                           std::vector<int64_t> input_size, int64_t stride) {
  check_conv_input(conv_name(dimensions), input_size, dimensions, stride);
  check_conv_weight(conv_name(dimensions), "weight", weight, dimensions, input_size[1]);
  const std::vector<int64_t> out_size = conv_out_sizes(input_size, weight.size(0), stride);
  ANYNET_CHECK(sizes(grad) == out_size && grad.scalar_type() == weight.scalar_type(), conv_name(dimensions),
               ": expected grad as ", dtype_name(weight.scalar_type()), " ", shape(out_size), ", got ",
               described(grad));
  ANYNET_CHECK(!before || (sizes(*before) == input_size && before->scalar_type() == grad.scalar_type()),
               conv_name(dimensions), ": expected before as ", dtype_name(grad.scalar_type()), " ", shape(input_size),
               ", got ", described(*before));
  Tensor grad_input = new_tensor(grad, input_size);
  const Tensor g = make_contiguous(grad), w = make_contiguous(weight);
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
  const char* op = conv_name(dimensions);
  check_conv_input(op, sizes(input), dimensions, stride);
  ANYNET_CHECK(grad.dim() == input.dim() && grad.size(1) <= conv_channels &&
                   sizes(grad) == conv_out_sizes(sizes(input), grad.size(1), stride) &&
                   grad.scalar_type() == input.scalar_type(),
               conv_name(dimensions), ": expected grad of the output's shape and dtype for input ", described(input),
               ", got ", described(grad));
  check_conv_vector(op, "scale", scale, input.size(1), input);
  check_conv_vector(op, "shift", shift, input.size(1), input);
  ANYNET_CHECK(scale.has_value() == shift.has_value(), conv_name(dimensions),
               ": expected both or none of scale and shift");
  const Tensor g = make_contiguous(grad), x = make_contiguous(input);
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
#endif

}  // namespace

#ifdef ANYNET_DEFINE_SCHEMAS
STABLE_TORCH_LIBRARY_FRAGMENT(ANYNET_NAMESPACE, m) {
  for (const std::string name : {"conv3x3", "conv3x3x3"}) {
    ANYNET_SCHEMA(
        m, (name +
            "(Tensor input, Tensor weight, Tensor? bias=None, Tensor? scale=None, Tensor? shift=None, int stride=1, "
            "bool relu_in=False, bool relu_out=False) -> Tensor")
               .c_str());
    ANYNET_SCHEMA(
        m, (name +
            "_backward_input(Tensor grad, Tensor weight, Tensor? before, SymInt[] input_size, int stride) -> Tensor")
               .c_str());
    ANYNET_SCHEMA(
        m,
        (name + "_backward_weight(Tensor grad, Tensor input, Tensor? scale, Tensor? shift, int stride, bool relu_in) "
                "-> (Tensor, Tensor)")
            .c_str());
  }
  ANYNET_SCHEMA(m, "conv_chain(Tensor input, Tensor[] weights, Tensor?[] biases, bool relu_out) -> Tensor");
}
#endif

STABLE_TORCH_LIBRARY_IMPL(ANYNET_NAMESPACE, ANYNET_DISPATCH_KEY, m) {
  m.impl("conv3x3", TORCH_BOX(&conv<2>));
  m.impl("conv3x3x3", TORCH_BOX(&conv<3>));
  m.impl("conv_chain", TORCH_BOX(&conv_chain));
#ifdef ANYNET_OPS_CPU
  m.impl("conv3x3_backward_input", TORCH_BOX(&conv_backward_input<2>));
  m.impl("conv3x3_backward_weight", TORCH_BOX(&conv_backward_weight<2>));
  m.impl("conv3x3x3_backward_input", TORCH_BOX(&conv_backward_input<3>));
  m.impl("conv3x3x3_backward_weight", TORCH_BOX(&conv_backward_weight<3>));
#endif
}

}  // namespace anynet::ops
