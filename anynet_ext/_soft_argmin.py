"""Soft-argmin: from a cost volume to the disparity it expects."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from anynet_ext import _checks, _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register


@overridable
def soft_argmin(cost: Tensor, first: int = 0) -> Tensor:
    """The expected disparity under softmax(-cost): `out[n,0,y,x] = sum_k (first + k) softmax_k(-cost[n,k,y,x])`.

    Args:
        cost: [N, D, H, W], D >= 1; low where left and right match. float32, float64, float16 or bfloat16, any layout.
        first: the disparity, in pixels, of `cost[:, 0]`.

    Returns:
        [N, 1, H, W], disparity in pixels. Half types are computed in float32 and rounded once; under
        autocast they give float32. There is no second derivative.

    Raises:
        TypeError, ValueError: if an argument has the wrong type, dtype or shape.

    Source: Kendall et al. 2017, eq. 1; AnyNet paper (arXiv 1810.11408), section III-B.
    """
    _check(cost, first)
    out: Tensor = torch.ops.anynet.soft_argmin(cost, first)
    return out


def _check(cost: Tensor, first: int) -> None:
    _checks.tensor("soft_argmin", "cost", cost, "N, D, H, W")
    _checks.integer("soft_argmin", "first", first)
    if _checks.surely(cost.shape[1] == 0):
        raise ValueError(f"soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got {list(cost.shape)}")


def _fake(cost: Tensor, first: int = 0) -> Tensor:
    _check(cost, first)
    n, _, h, w = cost.shape
    return cost.new_empty(n, 1, h, w)


def _fake_backward(grad: Tensor, cost: Tensor, first: int) -> Tensor:
    return cost.new_empty(cost.shape)


def _setup_context(ctx: Any, inputs: tuple[Tensor, int], output: Tensor) -> None:
    cost, ctx.first = inputs
    ctx.save_for_backward(cost)


def _backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
    (cost,) = ctx.saved_tensors
    grad_cost: Tensor = torch.ops.anynet.soft_argmin_backward(grad, cost, ctx.first)
    return grad_cost, None


register("soft_argmin", fake=_fake, fake_backward=_fake_backward, setup_context=_setup_context, backward=_backward)
