"""Convolutions of few channels, 3x3 and 3x3x3, with what surrounds them in a stereo network fused in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from anynet_ext import _checks, _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register, register_inference

CHANNELS = 64


@overridable
def conv3x3(
    input: Tensor,
    weight: Tensor,
    bias: Tensor | None = None,
    *,
    stride: int = 1,
    scale: Tensor | None = None,
    shift: Tensor | None = None,
    relu_in: bool = False,
    relu_out: bool = False,
) -> Tensor:
    """A 3x3 convolution with padding 1: `conv(a(input), weight) + bias`, then optionally ReLU.

    `a` is what comes before the convolution: `scale[c] * input[:, c] + shift[c]` if given, then ReLU if `relu_in`. The
    padding is zero after `a`, as when a batch norm and a ReLU precede the convolution.

    It is for layers whose channels are few and pixels many, where general libraries reach a few per cent of a CPU's
    arithmetic: pixels lie in the vector registers, in PyTorch's own layout, and nothing is reordered. Prefer PyTorch's
    (oneDNN's) convolutions for other kernel sizes, for rows much shorter than a vector (16 pixels), and on GPUs for
    more than 16 channels. On CUDA tensors the derivatives are PyTorch's own.

    On the CPU, float32 layers of stride 1 and enough channels, and their gradients by the input, use Winograd's
    algorithm: `conv3x3` if C * O >= 4 * (C + O), or 6 * (C + O) with AVX-512 or on Arm; `conv3x3x3` if C and O are at
    least 8 or, without AVX-512 and not on Arm, if C >= 2 and O >= 4. It computes tiles of up to 3 outputs along an
    axis. Rounding errors are then relative to the largest pixel that a tile sees, and a pixel that is NaN, infinite or
    near overflow can make all of the tile NaN or infinite.

    Args:
        input: [N, C, H, W], float32 or float64, 1 <= C <= 64; made contiguous if it is not.
        weight: [O, C, 3, 3], 1 <= O <= 64.
        bias: [O].
        stride: 1 or 2, along every dimension.
        scale, shift: [C], both or neither.
        relu_in, relu_out: ReLU before and after the convolution.

    Returns:
        [N, O, (H - 1) // stride + 1, (W - 1) // stride + 1]. Differentiable in every tensor; on the CPU the gradients
        repeat bit for bit whatever the number of threads. There is no second derivative. Under autocast half types
        give float32. On the CPU, what is NaN before `relu_in` has no gradient.

    Raises:
        TypeError, ValueError: if an argument has the wrong type, dtype or shape.
    """
    _check("conv3x3", 2, input, weight, bias, stride, scale, shift)
    out: Tensor = torch.ops.anynet.conv3x3(input, weight, bias, scale, shift, stride, relu_in, relu_out)
    return out


@overridable
def conv3x3x3(
    input: Tensor,
    weight: Tensor,
    bias: Tensor | None = None,
    *,
    stride: int = 1,
    scale: Tensor | None = None,
    shift: Tensor | None = None,
    relu_in: bool = False,
    relu_out: bool = False,
) -> Tensor:
    """`conv3x3` with one dimension more: input [N, C, D, H, W], weight [O, C, 3, 3, 3], padding 1 all round.

    Which layers use Winograd's algorithm, and what that means for rounding and NaN, is told there.
    """
    _check("conv3x3x3", 3, input, weight, bias, stride, scale, shift)
    out: Tensor = torch.ops.anynet.conv3x3x3(input, weight, bias, scale, shift, stride, relu_in, relu_out)
    return out


@overridable
def conv_chain(
    input: Tensor, weights: Sequence[Tensor], biases: Sequence[Tensor | None], *, relu_out: bool = False
) -> Tensor:
    """Convolutions of stride 1 one after another, with a ReLU after each but the last, for inference.

    It saves what the calls cost; on a GPU two layers are one launch where their channels are few.

    Args:
        input: [N, C, H, W] or [N, C, D, H, W] float32, contiguous, 1 <= C <= 64.
        weights: of each layer [O, C, 3, 3], or with a third 3; O <= 64 is the next one's C.
        biases: of each layer [O] or None.
        relu_out: ReLU after the last, too.

    Returns:
        [N, O, H, W] or [N, O, D, H, W].

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape or layout.
    """
    out: Tensor = torch.ops.anynet.conv_chain(input, list(weights), list(biases), relu_out)
    return out


def _fake_conv_chain(input: Tensor, weights: list[Tensor], biases: list[Tensor | None], relu_out: bool) -> Tensor:
    return input.new_empty(input.shape[0], weights[-1].shape[0], *input.shape[2:])


def _check(
    op: str,
    dimensions: int,
    input: Tensor,
    weight: Tensor,
    bias: Tensor | None,
    stride: int,
    scale: Tensor | None,
    shift: Tensor | None,
) -> None:
    layout = "N, C, H, W" if dimensions == 2 else "N, C, D, H, W"
    kernel = ", 3" * dimensions
    _checks.tensor(op, "input", input, layout)
    _checks.tensor(op, "weight", weight, f"O, C{kernel}")
    surely = _checks.surely
    in_channels, out_channels = input.shape[1], weight.shape[0]
    if surely(in_channels > CHANNELS) or any(surely(size == 0) for size in input.shape[1:]):
        raise ValueError(
            f"{op}: expected input of shape [{layout}] with C in 1..{CHANNELS} and at least one pixel, "
            f"got {list(input.shape)}"
        )
    sizes = zip(weight.shape[1:], (in_channels, *[3] * dimensions), strict=True)
    if surely(out_channels == 0) or surely(out_channels > CHANNELS) or any(surely(a != b) for a, b in sizes):
        raise ValueError(
            f"{op}: expected weight of shape [O, {in_channels}{kernel}] with O in 1..{CHANNELS}, "
            f"got {list(weight.shape)}"
        )
    for name, vector, channels in (
        ("bias", bias, out_channels),
        ("scale", scale, in_channels),
        ("shift", shift, in_channels),
    ):
        if vector is not None:
            _checks.tensor(op, name, vector, "C")
            if surely(vector.shape[0] != channels):
                raise ValueError(f"{op}: expected {name} of shape [{channels}], got {list(vector.shape)}")
    if (scale is None) != (shift is None):
        raise ValueError(f"{op}: expected both or neither of scale and shift")
    _checks.integer(op, "stride", stride)
    if stride not in (1, 2):
        raise ValueError(f"{op}: expected stride 1 or 2, got {stride}")
    tensors = [t for t in (input, weight, bias, scale, shift) if t is not None]
    dtypes = {_checks.computed_dtype(t) for t in tensors}
    if len(dtypes) > 1 or not dtypes <= {torch.float32, torch.float64}:
        raise TypeError(
            f"{op}: expected tensors of one dtype, float32 or float64, got "
            f"{', '.join(sorted({str(t.dtype) for t in tensors}))}"
        )


def _register(name: str, dimensions: int) -> None:
    """Registers one of the two operators; they differ in dimensions only."""
    op = f"anynet::{name}"
    backward_input = getattr(torch.ops.anynet, f"{name}_backward_input")
    backward_weight = getattr(torch.ops.anynet, f"{name}_backward_weight")
    per_channel = (1, -1, *[1] * dimensions)  # shape of a per-channel vector that multiplies a tensor

    def _fake(
        input: Tensor,
        weight: Tensor,
        bias: Tensor | None = None,
        scale: Tensor | None = None,
        shift: Tensor | None = None,
        stride: int = 1,
        relu_in: bool = False,
        relu_out: bool = False,
    ) -> Tensor:
        _check(name, dimensions, input, weight, bias, stride, scale, shift)
        sizes = [(size - 1) // stride + 1 for size in input.shape[2:]]
        return input.new_empty(input.shape[0], weight.shape[0], *sizes)

    def _fake_backward_input(
        grad: Tensor, weight: Tensor, before: Tensor | None, input_size: list[int], stride: int
    ) -> Tensor:
        return grad.new_empty(input_size)

    def _fake_backward_weight(
        grad: Tensor, input: Tensor, scale: Tensor | None, shift: Tensor | None, stride: int, relu_in: bool
    ) -> tuple[Tensor, Tensor]:
        return grad.new_empty(grad.shape[1], input.shape[1], *[3] * dimensions), grad.new_empty(grad.shape[1])

    def _affine(input: Tensor, scale: Tensor | None, shift: Tensor | None) -> Tensor:
        if scale is None or shift is None:
            return input
        return input * scale.view(per_channel) + shift.view(per_channel)

    def _convolution_backward(
        grad: Tensor, input: Tensor, weight: Tensor, stride: int, mask: list[bool]
    ) -> tuple[Tensor, Tensor, Tensor]:
        ones, zeros = [1] * dimensions, [0] * dimensions
        grads: tuple[Tensor, Tensor, Tensor] = torch.ops.aten.convolution_backward(
            grad, input, weight, [grad.shape[1]], [stride] * dimensions, ones, ones, False, zeros, 1, mask
        )
        return grads

    @torch.library.impl(f"{op}_backward_input", "CUDA")
    def _cuda_backward_input(
        grad: Tensor, weight: Tensor, before: Tensor | None, input_size: list[int], stride: int
    ) -> Tensor:
        input = grad.new_empty(1).expand(input_size)  # only its shape counts
        grad_input = _convolution_backward(grad, input, weight, stride, [True, False, False])[0].contiguous()
        return grad_input if before is None else torch.ops.aten.threshold_backward(grad_input, before, 0)

    @torch.library.impl(f"{op}_backward_weight", "CUDA")
    def _cuda_backward_weight(
        grad: Tensor, input: Tensor, scale: Tensor | None, shift: Tensor | None, stride: int, relu_in: bool
    ) -> tuple[Tensor, Tensor]:
        weight = grad.new_empty(1).expand(grad.shape[1], input.shape[1], *[3] * dimensions)
        activated = _affine(input, scale, shift)
        activated = activated.relu() if relu_in else activated
        _, grad_weight, grad_bias = _convolution_backward(grad, activated, weight, stride, [False, True, True])
        return grad_weight.contiguous(), grad_bias

    def _setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        input, weight, _bias, scale, shift, ctx.stride, ctx.relu_in, ctx.relu_out = inputs
        ctx.save_for_backward(input, weight, scale, shift, output if ctx.relu_out else None)

    def _backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        input, weight, scale, shift, output = ctx.saved_tensors
        needs = [*ctx.needs_input_grad, *[False] * 4]  # it ends with the last argument that was given
        if output is not None:
            grad = torch.ops.aten.threshold_backward(grad, output, 0)
        grad_input = grad_weight = grad_bias = grad_scale = grad_shift = None
        if needs[1] or needs[2]:
            grad_weight, grad_bias = backward_weight(grad, input, scale, shift, ctx.stride, ctx.relu_in)
        if needs[0] or needs[3] or needs[4]:
            before = _affine(input, scale, shift) if ctx.relu_in else None
            grad_input = backward_input(grad, weight, before, input.shape, ctx.stride)
            if scale is not None:
                pixels = [0, *range(2, input.dim())]
                grad_scale, grad_shift = (grad_input * input).sum(pixels), grad_input.sum(pixels)
                grad_input = grad_input * scale.view(per_channel)
        return (
            grad_input,
            grad_weight,
            grad_bias if needs[2] else None,
            grad_scale,
            grad_shift,
            None,
            None,
            None,
        )

    register(
        name,
        fake=_fake,
        fake_backward={"backward_input": _fake_backward_input, "backward_weight": _fake_backward_weight},
        setup_context=_setup_context,
        backward=_backward,
        shared=("weight", "bias", "scale", "shift"),
    )


_register("conv3x3", 2)
_register("conv3x3x3", 3)
register_inference("conv_chain", _fake_conv_chain)
