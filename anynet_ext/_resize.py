"""Bilinear resize, scaled and added."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from anynet_ext import _checks, _library, reference  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register


@overridable
def resize(
    input: Tensor,
    size: tuple[int, int],
    *,
    scale: float = 1.0,
    add: Tensor | None = None,
    align_corners: bool = False,
) -> Tensor:
    """`add + scale * bilinear(input)`: what `torch.nn.functional.interpolate` computes, several times faster.

    With disparity, `scale` is the ratio of the widths: a disparity counts pixels of the tensor it belongs to.

    Args:
        input: [N, C, h, w], h and w >= 1. float32, float64, float16 or bfloat16, any layout.
        size: (H, W) of the result.
        scale: factor on the resized input.
        add: [N, C, H, W], same dtype and device, or None for nothing.
        align_corners: whether corner pixels' centers meet (True) or pixels are areas (False).

    Returns:
        [N, C, H, W], contiguous. Half types are computed in float32 and rounded once; under autocast they give
        float32. There is no second derivative.

    Raises:
        TypeError, ValueError: if an argument has the wrong type, dtype, device or shape.

    Source: the upsampling between AnyNet's stages (arXiv 1810.11408, Fig. 2) and in its U-Net.
    """
    if not isinstance(size, Sequence) or len(size) != 2:
        raise TypeError(f"resize: expected size as (H, W), got {size!r}")
    height, width = size
    _check(input, height, width, add)
    out: Tensor = torch.ops.anynet.resize(input, height, width, scale, add, align_corners)
    return out


def _check(input: Tensor, height: int, width: int, add: Tensor | None) -> None:
    _checks.tensor("resize", "input", input, "N, C, H, W")
    for value in (height, width):
        _checks.integer("resize", "size", value)
    n, c, h, w = input.shape
    if _checks.surely(h == 0) or _checks.surely(w == 0):
        raise ValueError(f"resize: expected input of shape [N, C, H, W] with H, W >= 1, got {list(input.shape)}")
    if _checks.surely(height < 1) or _checks.surely(width < 1):
        raise ValueError(f"resize: expected size of at least 1 x 1, got {height} x {width}")
    if add is not None:
        _checks.matches("resize", "add", add, (n, c, height, width), input)


def _fake(
    input: Tensor, height: int, width: int, scale: float = 1.0, add: Tensor | None = None, align_corners: bool = False
) -> Tensor:
    _check(input, height, width, add)
    return input.new_empty(input.shape[0], input.shape[1], height, width)


def _fake_backward(grad: Tensor, height: int, width: int, scale: float, align_corners: bool) -> Tensor:
    return grad.new_empty(grad.shape[0], grad.shape[1], height, width)


def _setup_context(ctx: Any, inputs: tuple[Tensor, int, int, float, Tensor | None, bool], output: Tensor) -> None:
    input, _, _, ctx.scale, add, ctx.align_corners = inputs
    ctx.adds = add is not None
    ctx.size = input.shape[2:]


def _backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, None, None, None, Tensor | None, None]:
    grad_input = None
    if ctx.needs_input_grad[0]:
        grad_input = torch.ops.anynet.resize_backward(grad, *ctx.size, ctx.scale, ctx.align_corners)
    return grad_input, None, None, None, grad if ctx.adds else None, None


register("resize", fake=_fake, fake_backward=_fake_backward, setup_context=_setup_context, backward=_backward)


def _by_pytorch(
    input: Tensor, height: int, width: int, scale: float = 1.0, add: Tensor | None = None, align_corners: bool = False
) -> Tensor:
    _check(input, height, width, add)
    if 0 in input.shape[:2]:  # PyTorch's takes no empty channels
        return _fake(input, height, width)
    out = reference.resize(input, (height, width), scale=scale, add=add, align_corners=align_corners)
    return out.contiguous()


def _backward_by_pytorch(grad: Tensor, height: int, width: int, scale: float, align_corners: bool) -> Tensor:
    n, c, *size = grad.shape
    if 0 in (n, c):
        return _fake_backward(grad, height, width, scale, align_corners)
    scaled = scale * (grad.float() if grad.dtype in (torch.float16, torch.bfloat16) else grad)
    out: Tensor = torch.ops.aten.upsample_bilinear2d_backward(scaled, size, [n, c, height, width], align_corners)
    return out.to(grad.dtype).contiguous()


torch.library.impl("anynet::resize", "CUDA", _by_pytorch)
torch.library.impl("anynet::resize_backward", "CUDA", _backward_by_pytorch)
