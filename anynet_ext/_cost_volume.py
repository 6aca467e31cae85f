"""Cost volume: how badly each pixel of the left features matches the right ones at each disparity."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from anynet_ext import _checks, _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register, register_inference


@overridable
def cost_volume(left: Tensor, right: Tensor, disparity: Tensor | None = None, first: int = 0, last: int = 0) -> Tensor:
    """L1 matching cost of each left pixel at disparities around a map:

        out[n,k,y,x] = sum_c | left[n,c,y,x] - right[n,c,y, x - disparity[n,0,y,x] - (first + k)] |

    for k from 0 to last - first.

    right is sampled as by `warp`: linear between pixels, exact at integer positions, 0 outside the image; NaN where
    disparity is NaN. The derivative of |.| at 0 is 0.

    Args:
        left, right: [N, C, H, W] features of the two views. float32, float64, float16 or bfloat16, any layout.
        disparity: [N, 1, H, W], pixels, same dtype and device; None means 0 everywhere.
        first, last: the range of offsets in pixels, both included, first <= last.

    Returns:
        [N, last - first + 1, H, W], contiguous. Half types are computed in float32 and rounded once; under
        autocast they give float32. There is no second derivative.

    Raises:
        TypeError, ValueError: if an argument has the wrong type, dtype, device or shape, or first > last.

    Source: AnyNet paper (arXiv 1810.11408), sections III-B and III-C, Fig. 3.
    """
    _check(left, right, disparity, first, last)
    out: Tensor = torch.ops.anynet.cost_volume(left, right, disparity, first, last)
    return out


def _check(left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int) -> None:
    _checks.tensor("cost_volume", "left", left, "N, C, H, W")
    _checks.matches("cost_volume", "right", right, left.shape, left)
    if disparity is not None:
        n, _, h, w = left.shape
        _checks.matches("cost_volume", "disparity", disparity, (n, 1, h, w), left)
    _checks.integer("cost_volume", "first", first)
    _checks.integer("cost_volume", "last", last)
    if first > last:
        raise ValueError(f"cost_volume: expected first <= last, got first {first} and last {last}")


@overridable
def cost_volume_affine_relu(
    left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int, scale: Tensor, shift: Tensor
) -> Tensor:
    """`relu(scale * cost_volume + shift)`: the input of a cost network's first convolution, for inference.

    Args:
        left: [N, C, H, W] float32, contiguous; the G groups of channels of a pair are G samples of the batch.
        right: [N, C, H, W] float32.
        disparity: [N, 1, H, W] or None.
        first, last: the offsets to compare at.
        scale, shift: [G], for sample n those at n % G.

    Returns:
        [N, last - first + 1, H, W].

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.
    """
    out: Tensor = torch.ops.anynet.cost_volume_affine_relu(left, right, disparity, first, last, scale, shift)
    return out


def _fake(left: Tensor, right: Tensor, disparity: Tensor | None = None, first: int = 0, last: int = 0) -> Tensor:
    _check(left, right, disparity, first, last)
    n, _, h, w = left.shape
    return left.new_empty(n, last - first + 1, h, w)


def _fake_backward(
    grad: Tensor, left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int
) -> tuple[Tensor, Tensor, Tensor]:
    grad_disparity = left.new_empty(0) if disparity is None else disparity.new_empty(disparity.shape)
    return left.new_empty(left.shape), right.new_empty(right.shape), grad_disparity


def _setup_context(ctx: Any, inputs: tuple[Tensor, Tensor, Tensor | None, int, int], output: Tensor) -> None:
    left, right, disparity, ctx.first, ctx.last = inputs
    ctx.save_for_backward(left, right, disparity)


def _backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, Tensor | None, None, None]:
    left, right, disparity = ctx.saved_tensors
    grads = torch.ops.anynet.cost_volume_backward(grad, left, right, disparity, ctx.first, ctx.last)
    return grads[0], grads[1], None if disparity is None else grads[2], None, None


register("cost_volume", fake=_fake, fake_backward=_fake_backward, setup_context=_setup_context, backward=_backward)


def _fake_cost_volume_affine_relu(
    left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int, scale: Tensor, shift: Tensor
) -> Tensor:
    n, _, h, w = left.shape
    return left.new_empty(n, last - first + 1, h, w)


register_inference("cost_volume_affine_relu", _fake_cost_volume_affine_relu)
