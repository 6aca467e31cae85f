"""Floating-point operations of every operator, for `torch.utils.flop_counter.FlopCounterMode`.

A formula gets the shapes of the operator's result and of its tensors. As PyTorch counts, a multiplication and the
addition after it are two; comparisons, conversions and addresses are none. A backward operator is taken to need as many
as two forward ones; either of a convolution's two, as many as the forward one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import torch
from torch.utils.flop_counter import register_flop_formula

from anynet_ext import _library  # noqa: F401  (loads the operators)

Shape = Sequence[int]

LERP = 3  # a difference, a product, a sum
BILINEAR = 3 * LERP


def _convolution(out: Shape, input: Shape, weight: Shape, *_: Any) -> int:
    return 2 * prod(out) * prod(weight[1:])


def _conv_chain(out: Shape, input: Shape, weights: Sequence[Shape], *_: Any) -> int:
    return sum(_convolution((input[0], weight[0], *input[2:]), input, weight) for weight in weights)


def _cost_volume(out: Shape, left: Shape, right: Shape, disparity: Shape | None = None, *_: Any) -> int:
    per_channel = 3 + (LERP if disparity is not None else 0)  # difference, absolute value, sum; sampling
    return prod(out) * left[1] * per_channel


def _stem(out: Shape, left: Shape, right: Shape, mean: Shape, first: Shape, bias: Shape, second: Shape, *_: Any) -> int:
    pixels = 16 * out[0] * prod(out[2:])  # of both images, enlarged and padded
    return 2 * pixels * prod(first) + 2 * (pixels // 4) * prod(second) + 2 * prod(out)


def _candidate_costs(out: Shape, features: Shape, disparity: Shape, groups: int, first: int, last: int, *_: Any) -> int:
    pixels, channels = prod(features[2:]), features[1]
    return pixels * (channels * (last - first + 3) * (3 + LERP) + 2)


# Per value of the result.
_PER_VALUE = {
    "convex_upsampling": 2 * 9 + 3 * 9,  # sum of products; exponential, sum and quotient
    "fill_occlusions": 2 * 4 + 6,  # two blends; positions and masks
    "max_pool": 2,
    "normalized_propagation": 8 + 6,
    "read_image": BILINEAR + 2,
    "refinement_guide": BILINEAR + 2,  # for most of its values
    "resize": BILINEAR + 2,
    "spatial_propagation": 8,  # four products and sums
    "upsample_add": 7 * LERP + 3,
    "upsample_concat": BILINEAR + 2,
    "warp": LERP,
}

_FORMULAS: dict[str, Callable[..., int]] = {
    "batch_norm_relu": lambda out, input, *_: 7 * prod(input),  # mean, variance, affine
    "candidate_costs": _candidate_costs,
    "conv3x3": _convolution,
    "conv3x3x3": _convolution,
    "conv_chain": _conv_chain,
    "cost_volume": _cost_volume,
    "cost_volume_affine_relu": lambda out, *shapes: _cost_volume(out, *shapes) + 2 * prod(out),
    "expected_disparity": lambda out, cost, *_: 5 * prod(cost),
    "soft_argmin": lambda out, cost, *_: 4 * prod(cost),  # exponential, its sum, sum of products
    "stem": _stem,
    "upsample_sum": lambda out, maps, *_: (BILINEAR + 1) * len(maps) * prod(out),
} | {name: lambda out, *_, count=count: count * prod(out) for name, count in _PER_VALUE.items()}


def _register(name: str, formula: Callable[[Any, tuple[Any, ...]], int]) -> None:
    def counted(*args: Any, out_shape: Any = None, out: Any = None, **kwargs: Any) -> int:
        return formula(out_shape if out is None else out, args)

    register_flop_formula(getattr(torch.ops.anynet, name))(counted)


def _forward(formula: Callable[..., int]) -> Callable[[Any, tuple[Any, ...]], int]:
    return lambda out, args: formula(out, *args)


def _backward(formula: Callable[..., int]) -> Callable[[Any, tuple[Any, ...]], int]:
    """Twice the forward pass, whose result has the first argument's shape."""
    return lambda out, args: 2 * formula(*args)


for _name, _formula in _FORMULAS.items():
    _register(_name, _forward(_formula))
for _name in ("batch_norm_relu", "cost_volume", "resize", "soft_argmin", "spatial_propagation", "warp"):
    _register(f"{_name}_backward", _backward(_FORMULAS[_name]))
for _name in ("conv3x3", "conv3x3x3"):
    # Of (grad, weight, before, input_size, stride) and (grad, input, scale, shift, stride, relu_in).
    _register(f"{_name}_backward_input", lambda out, args: _convolution(args[0], args[3], args[1]))
    _register(f"{_name}_backward_weight", lambda out, args: _convolution(args[0], args[1], out[0]))
