"""Spatial propagation: one scan of a three-way linear propagation across an image."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from anynet_ext import _checks, _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register, register_inference


@overridable
def spatial_propagation(input: Tensor, gates: Tensor, direction: int) -> Tensor:
    """Scans each channel in one direction; every pixel blends with its three neighbors in the line before:

        h[t] = (1 - sum_j g_j) input[t] + sum_j g_j h[t - 1, shifted by j],   j = -1, 0, +1 across the scan

    A gate whose neighbor lies outside the image counts as 0 in both sums, so the first line is the input's. Gates are
    used as given: a network that wants the scan to be stable keeps sum_j |g_j| <= 1.

    Args:
        input: [N, C, H, W]. float32, float64, float16 or bfloat16, any layout.
        gates: [N, 3, C, H, W], same dtype and device; `gates[:, 0]` weighs the neighbor with the smaller row (or
            column) index, `[:, 1]` the one straight before, `[:, 2]` the one with the larger index.
        direction: 0 left to right, 1 right to left, 2 top to bottom, 3 bottom to top.

    Returns:
        h, [N, C, H, W], contiguous. Half types are computed in float32 and rounded once; under autocast they give
        float32. There is no second derivative.

    Raises:
        TypeError, ValueError: if an argument has the wrong type, dtype, device or shape, or direction is not 0 to 3.

    Source: Liu et al. 2017, section 3.2; AnyNet paper (arXiv 1810.11408), section III-D.
    """
    _check(input, gates, direction)
    out: Tensor = torch.ops.anynet.spatial_propagation(input, gates, direction)
    return out


def _check(input: Tensor, gates: Tensor, direction: int) -> None:
    _checks.tensor("spatial_propagation", "input", input, "N, C, H, W")
    n, c, h, w = input.shape
    _checks.matches("spatial_propagation", "gates", gates, (n, 3, c, h, w), input)
    _checks.integer("spatial_propagation", "direction", direction)
    if direction not in (0, 1, 2, 3):
        raise ValueError(f"spatial_propagation: expected direction 0, 1, 2 or 3, got {direction}")


@overridable
def normalized_propagation(input: Tensor, gates: Tensor, direction: int) -> Tensor:
    """`spatial_propagation` with each pixel's three gates over the sum of their absolute values plus 1e-8.

    For inference.

    [N, C, H, W], [N, 3, C, H, W] -> [N, C, H, W], float32, contiguous.

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape or layout, or the direction is not 0, 1, 2 or 3.
    """
    out: Tensor = torch.ops.anynet.normalized_propagation(input, gates, direction)
    return out


def _fake(input: Tensor, gates: Tensor, direction: int) -> Tensor:
    _check(input, gates, direction)
    return input.new_empty(input.shape)


def _fake_backward(grad: Tensor, input: Tensor, gates: Tensor, out: Tensor, direction: int) -> tuple[Tensor, Tensor]:
    return input.new_empty(input.shape), gates.new_empty(gates.shape)


def _setup_context(ctx: Any, inputs: tuple[Tensor, Tensor, int], output: Tensor) -> None:
    input, gates, ctx.direction = inputs
    ctx.save_for_backward(input, gates, output)


def _backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, None]:
    grads = torch.ops.anynet.spatial_propagation_backward(grad, *ctx.saved_tensors, ctx.direction)
    return grads[0], grads[1], None


register(
    "spatial_propagation", fake=_fake, fake_backward=_fake_backward, setup_context=_setup_context, backward=_backward
)


def _fake_normalized_propagation(input: Tensor, gates: Tensor, direction: int) -> Tensor:
    return torch.empty_like(input, memory_format=torch.contiguous_format)


register_inference("normalized_propagation", _fake_normalized_propagation)
