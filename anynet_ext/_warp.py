"""Warp: an image sampled along its rows by a disparity map."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from anynet_ext import _checks, _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register


@overridable
def warp(image: Tensor, disparity: Tensor) -> Tensor:
    """The right image as the left camera would see it: `out[n,c,y,x] = image[n,c,y, x - disparity[n,0,y,x]]`.

    Sampling is linear between pixels, exact at integer positions, and 0 outside the image (a position within one pixel
    of the border blends with 0). The derivative by the disparity is one-sided at integer positions, towards larger
    columns. A NaN disparity gives NaN and passes no gradient.

    Args:
        image: [N, C, H, W]. float32, float64, float16 or bfloat16, any layout.
        disparity: [N, 1, H, W], pixels, same dtype and device as image.

    Returns:
        [N, C, H, W], contiguous. Half types are computed in float32 and rounded once; under autocast they give
        float32. There is no second derivative.

    Raises:
        TypeError, ValueError: if an argument has the wrong type, dtype, device or shape.

    Source: AnyNet paper (arXiv 1810.11408), section III-C.
    """
    _check(image, disparity)
    out: Tensor = torch.ops.anynet.warp(image, disparity)
    return out


def _check(image: Tensor, disparity: Tensor) -> None:
    _checks.tensor("warp", "image", image, "N, C, H, W")
    n, _, h, w = image.shape
    _checks.matches("warp", "disparity", disparity, (n, 1, h, w), image)


def _fake(image: Tensor, disparity: Tensor) -> Tensor:
    _check(image, disparity)
    return image.new_empty(image.shape)


def _fake_backward(grad: Tensor, image: Tensor, disparity: Tensor) -> tuple[Tensor, Tensor]:
    return image.new_empty(image.shape), disparity.new_empty(disparity.shape)


def _setup_context(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
    ctx.save_for_backward(*inputs)


def _backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor]:
    grads: tuple[Tensor, Tensor] = torch.ops.anynet.warp_backward(grad, *ctx.saved_tensors)
    return grads


register("warp", fake=_fake, fake_backward=_fake_backward, setup_context=_setup_context, backward=_backward)
