"""spatial_propagation and normalized_propagation."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
import torch
from differentiable_operator import DifferentiableOperator
from hypothesis import given
from inference_operator import Call, InferenceOperator, call, random
from operator_cases import LARGE, Case, check_far
from strategies import directions, few, seeds, sizes
from torch import Tensor

from anynet_ext import reference

NAN, INF = torch.nan, torch.inf
IMAGE = torch.zeros(2, 3, 4, 5)
DISPARITY = torch.zeros(2, 1, 4, 5)
GATES = torch.zeros(2, 3, 3, 4, 5)


def _features(*shape: int) -> Tensor:
    return torch.randn(shape, dtype=torch.float64)


def _spatial_propagation(n: int, c: int, h: int, w: int) -> list[Case]:
    def make() -> list[Tensor | None]:
        return [_features(n, c, h, w), torch.rand(n, 3, c, h, w, dtype=torch.float64) * 0.6 - 0.3]

    return [Case("spatial_propagation", make, (d,), f"{n}x{c}x{h}x{w}-{'LRTB'[d]}") for d in range(4)]


class TestSpatialPropagation(DifferentiableOperator):
    op = "spatial_propagation"
    # Odd and tiny sizes, ranges wider than the image or outside it, empty tensors, and sizes around a vector's length.
    cases: ClassVar = [
        *_spatial_propagation(2, 3, 4, 7),
        *_spatial_propagation(1, 1, 1, 1),
        *_spatial_propagation(1, 2, 1, 5),
        *_spatial_propagation(1, 2, 5, 1),
        *_spatial_propagation(1, 1, 2, 2),
        *_spatial_propagation(1, 2, 19, 37),
        *_spatial_propagation(1, 1, 35, 16),
        *_spatial_propagation(0, 2, 3, 4),
        *_spatial_propagation(1, 0, 3, 4),
        *_spatial_propagation(1, 2, 0, 4),
        *_spatial_propagation(1, 2, 3, 0),
    ]
    calls: ClassVar = [
        Case(
            "spatial_propagation", lambda: [torch.randn(2, 3, 4, 9), torch.rand(2, 3, 3, 4, 9) * 0.5 - 0.25], (2,), ""
        ),
    ]
    large_calls: ClassVar = [
        *[
            Case(
                "spatial_propagation",
                lambda: [torch.randn(LARGE), torch.rand(2, 3, *LARGE[1:]) * 0.6 - 0.3],
                (d,),
                "LRTB"[d],
            )
            for d in range(4)
        ],
    ]
    function_errors: ClassVar = [
        ((0, GATES, 0), TypeError, "spatial_propagation: expected input to be a Tensor, got int"),
        (
            (IMAGE.int(), GATES, 0),
            TypeError,
            "spatial_propagation: expected input of dtype float32, float64, float16 or bfloat16, got torch.int32",
        ),
        (
            (GATES, GATES, 0),
            ValueError,
            "spatial_propagation: expected input of shape [N, C, H, W], got [2, 3, 3, 4, 5]",
        ),
        (
            (IMAGE, IMAGE, 0),
            ValueError,
            "spatial_propagation: expected gates of shape [2, 3, 3, 4, 5], got [2, 3, 4, 5]",
        ),
        (
            (IMAGE, GATES[:, :2], 0),
            ValueError,
            "spatial_propagation: expected gates of shape [2, 3, 3, 4, 5], got [2, 2, 3, 4, 5]",
        ),
        (
            (IMAGE, GATES.double(), 0),
            TypeError,
            "spatial_propagation: expected all tensors of one dtype, got torch.float32 and, for gates, torch.float64",
        ),
        (
            (IMAGE, GATES.to("meta"), 0),
            ValueError,
            "spatial_propagation: expected all tensors on one device, got cpu and, for gates, meta",
        ),
        (
            (IMAGE, GATES, 4),
            ValueError,
            "spatial_propagation: expected direction 0, 1, 2 or 3, got 4",
        ),
        (
            (IMAGE, GATES, -1),
            ValueError,
            "spatial_propagation: expected direction 0, 1, 2 or 3, got -1",
        ),
        (
            (IMAGE, GATES, "left"),
            TypeError,
            "spatial_propagation: expected direction to be an int, got str",
        ),
    ]
    operator_errors: ClassVar = [
        (
            "spatial_propagation",
            (GATES, GATES, 0),
            "spatial_propagation: expected input of shape [N, C, H, W], got [2, 3, 3, 4, 5]",
        ),
        (
            "spatial_propagation",
            (IMAGE, IMAGE, 0),
            "spatial_propagation: expected gates of shape [2, 3, 3, 4, 5], got [2, 3, 4, 5]",
        ),
        ("spatial_propagation", (IMAGE, GATES, 7), "spatial_propagation: expected direction 0, 1, 2 or 3, got 7"),
        (
            "spatial_propagation_backward",
            (DISPARITY, IMAGE, GATES, IMAGE, 0),
            "spatial_propagation_backward: expected grad of shape [2, 3, 4, 5], got [2, 1, 4, 5]",
        ),
        (
            "spatial_propagation_backward",
            (IMAGE, IMAGE, GATES, DISPARITY, 0),
            "spatial_propagation_backward: expected out of shape [2, 3, 4, 5], got [2, 1, 4, 5]",
        ),
    ]


def propagation_call(shape: tuple[int, ...], direction: int) -> Call:
    def make() -> tuple[tuple[Any, ...], dict[str, Any]]:
        gates = random(shape[0], 3, *shape[1:])
        gates[..., -1] = 0  # nothing to normalize
        return call(random(*shape), gates, direction)

    return make


class TestNormalizedPropagation(InferenceOperator):
    op = "normalized_propagation"
    tolerance: ClassVar = {"rtol": 1.3e-6, "atol": 1e-5}
    cases: ClassVar = {
        f"{shape}-{direction}": propagation_call(shape, direction)
        for shape in [(1, 2, 4, 4), (1, 1, 1, 1), (3, 2, 5, 17), (1, 8, 30, 40), (0, 2, 2, 2), (1, 2, 0, 3)]
        for direction in range(4)
    }
    errors: ClassVar = [
        (
            lambda: call(random(1, 1, 2, 2), random(1, 2, 1, 2, 2), 0),
            r"gates of shape \[1, 3, 1, 2, 2\], got \[1, 2, 1, 2, 2\]",
        ),
        (
            lambda: call(random(1, 1, 2, 2), random(1, 3, 1, 2, 2), 4),
            "normalized_propagation: expected direction 0, 1, 2 or 3, got 4",
        ),
        (lambda: call(random(1, 2, 2), random(1, 3, 1, 2, 2), 0), "input as contiguous float32 tensor of 4 dimensions"),
    ]


@pytest.mark.parametrize("direction", range(4))
@pytest.mark.parametrize("value", [NAN, INF])
def test_special_values(ops, direction, value):
    input = torch.randn(1, 1, 9, 11, dtype=torch.float64)
    gates = torch.rand(1, 3, 1, 9, 11, dtype=torch.float64) * 0.3
    # Gates whose neighbor lies outside do not count, whatever they hold.
    first = {0: (..., slice(0, 1)), 1: (..., slice(-1, None)), 2: (..., slice(0, 1), slice(None))}
    gates[first.get(direction, (..., slice(-1, None), slice(None)))] = value
    out = ops.spatial_propagation(input.to(ops.device), gates.to(ops.device), direction).cpu()
    assert out.isfinite().all()
    torch.testing.assert_close(out, reference.spatial_propagation(input, gates, direction))
    input[0, 0, 4, 5] = value
    out = ops.spatial_propagation(input.to(ops.device), gates.to(ops.device), direction).cpu()
    expected = reference.spatial_propagation(input, gates, direction)
    assert not expected.isfinite().all()
    torch.testing.assert_close(out, expected, equal_nan=True)


@pytest.mark.parametrize("dim", range(4))
def test_strides_beyond_32_bits(ops, memory, dim):
    if ops.device != "cpu":
        pytest.skip("uses virtual memory of the CPU")
    shape = [3 if i == dim else 2 for i in range(4)]
    n, c, h, w = shape
    image = torch.randn(*shape).bfloat16()
    gates = (torch.rand(n, 3, c, h, w) / 4).bfloat16()

    def call(o, x: Tensor) -> Tensor:
        return o.spatial_propagation(x, gates, 0)

    check_far(ops, memory, image, dim, call)


@few
@given(sizes, seeds, directions)
def test_spatial_propagation_keeps_constants(ops, uniform, size, seed, direction):
    n, c, h, w = size
    gates = uniform(seed, n, 3, c, h, w, scale=0.2)
    constant = torch.full(size, 3.25, dtype=torch.float64, device=gates.device)
    torch.testing.assert_close(ops.spatial_propagation(constant, gates, direction), constant)


@few
@given(sizes, seeds, directions)
def test_spatial_propagation_directions_are_mirror_images(ops, uniform, size, seed, direction):
    n, c, h, w = size
    image, gates = uniform(seed, *size), uniform(seed + 1, n, 3, c, h, w, scale=0.2)
    out = ops.spatial_propagation(image, gates, direction)
    torch.testing.assert_close(out, reference.spatial_propagation(image, gates, direction))
    axis = -1 if direction < 2 else -2
    flipped = ops.spatial_propagation(image.flip(axis), gates.flip(axis), direction ^ 1).flip(axis)
    assert torch.equal(out, flipped)
    turned = ops.spatial_propagation(image.mT, gates.mT, (direction + 2) % 4).mT
    torch.testing.assert_close(out, turned)
