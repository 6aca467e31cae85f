"""Batch norm and ReLU in training, in as few passes over memory as they need."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from anynet_ext import _checks, _library  # noqa: F401  (loads the operators)
from anynet_ext._register import no_second_derivative, overridable, register_derivative, register_fake


@overridable
def batch_norm_relu(input: Tensor, weight: Tensor, bias: Tensor, *, eps: float = 1e-5) -> tuple[Tensor, Tensor, Tensor]:
    """`relu(batch_norm(input))` by the batch's own statistics, and these.

    PyTorch's goes through a CPU's memory element by element, and ReLU once more; on a GPU it gives each channel
    one block of threads. With running statistics, in eval mode, there is nothing to gain: use PyTorch's.

    Args:
        input: [N, C, ...], float32 or float64, with more than one value per channel; made contiguous if it is not.
        weight, bias: [C].
        eps: added to the variance.

    Returns:
        [N, C, ...], differentiable in all tensors; and, [C] each and without gradients, the channels' means and
        variances (over the number of values, as they normalize). Results and gradients repeat bit for bit whatever the
        number of threads. Under autocast half types give float32. There is no second derivative.

    Raises:
        TypeError, ValueError: if an argument has the wrong type, dtype or shape.

    Source: Ioffe and Szegedy 2015 (arXiv 1502.03167), algorithm 1.
    """
    _check(input, weight, bias, eps)
    out: tuple[Tensor, Tensor, Tensor] = torch.ops.anynet.batch_norm_relu(input, weight, bias, eps)
    return out


def _check(input: Tensor, weight: Tensor, bias: Tensor, eps: float) -> None:
    if not isinstance(input, Tensor) or input.dim() < 2 or _checks.surely(input.shape[1] == 0):
        came = list(input.shape) if isinstance(input, Tensor) else type(input).__name__
        raise ValueError(f"batch_norm_relu: expected input of shape [N, C, ...], got {came}")
    if _checks.surely(input.numel() // input.shape[1] < 2):
        raise ValueError(f"batch_norm_relu: expected more than one value per channel, got {list(input.shape)}")
    if not eps > 0:
        raise ValueError(f"batch_norm_relu: expected eps above 0, got {eps}")
    if _checks.computed_dtype(input) not in (torch.float32, torch.float64):
        raise TypeError(f"batch_norm_relu: expected tensors of dtype float32 or float64, got {input.dtype}")
    for name, vector in (("weight", weight), ("bias", bias)):
        _checks.matches("batch_norm_relu", name, vector, input.shape[1:2], input)


def _fake(input: Tensor, weight: Tensor, bias: Tensor, eps: float = 1e-5) -> tuple[Tensor, Tensor, Tensor]:
    _check(input, weight, bias, eps)
    return input.new_empty(input.shape), weight.new_empty(weight.shape), weight.new_empty(weight.shape)


def _fake_backward(
    grad: Tensor, input: Tensor, weight: Tensor, bias: Tensor, mean: Tensor, variance: Tensor, eps: float
) -> tuple[Tensor, Tensor, Tensor]:
    return input.new_empty(input.shape), weight.new_empty(weight.shape), bias.new_empty(bias.shape)


def _setup_context(ctx: Any, inputs: tuple[Tensor, Tensor, Tensor, float], output: tuple[Tensor, ...]) -> None:
    *tensors, ctx.eps = inputs
    _, mean, variance = output
    ctx.mark_non_differentiable(mean, variance)
    ctx.save_for_backward(*tensors, mean, variance)


def _backward(ctx: Any, grad: Tensor, *_: object) -> tuple[Tensor | None, ...]:
    grads = torch.ops.anynet.batch_norm_relu_backward(grad, *ctx.saved_tensors, ctx.eps)
    return *grads, None


register_fake("anynet::batch_norm_relu", _fake)
register_fake("anynet::batch_norm_relu_backward", _fake_backward)
register_derivative("anynet::batch_norm_relu", _backward, setup_context=_setup_context)
register_derivative("anynet::batch_norm_relu_backward", no_second_derivative("anynet::batch_norm_relu_backward"))
for _device in ("cpu", "cuda"):
    torch.library.register_autocast("anynet::batch_norm_relu", _device, torch.float32)
