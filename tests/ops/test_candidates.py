"""candidate_costs and expected_disparity against the cost volumes and the softmax that they fuse."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
import torch
from inference_operator import Call, InferenceOperator, call, random
from torch import Tensor

import anynet_ext
from anynet_ext import reference

FEATURES, DISPARITY = random(2, 4, 3, 5), random(1, 1, 3, 5)


def costs_call(size: tuple[int, int], groups: int, radius: int) -> Call:
    return lambda: call(random(2, 4, *size), 5 * random(1, 1, *size), groups, -2, 1, radius)


def wrong(
    features: Tensor = FEATURES,
    disparity: Tensor = DISPARITY,
    *,
    groups: int = 2,
    first: int = -2,
    last: int = 2,
    radius: int = 1,
) -> Call:
    return lambda: call(features, disparity, groups, first, last, radius)


class TestCandidateCosts(InferenceOperator):
    op = "candidate_costs"
    cases: ClassVar = {
        f"{size}-{groups}-{radius}": costs_call(size, groups, radius)
        for size in [(3, 4), (1, 1), (5, 70), (12, 33)]
        for groups in (1, 2)
        for radius in (1, 0, 2, 5)
    }
    errors: ClassVar = [
        (wrong(FEATURES[:1]), r"features of shape \[2, 4, 3, 5\], got \[1, 4, 3, 5\]"),
        (wrong(FEATURES, FEATURES[:1]), r"disparity of shape \[1, 1, 3, 5\], got \[1, 4, 3, 5\]"),
        (wrong(groups=3), "groups to divide the 4 channels, got 3"),
        (wrong(groups=0), "groups to divide the 4 channels, got 0"),
        (wrong(FEATURES[:, :0], groups=2**62), "groups to divide the 0 channels, got 4611686018427387904"),
        (wrong(first=2, last=-2), "first <= last, got first 2 and last -2"),
        (wrong(radius=-1), "radius of 0 to 1024, got -1"),
        (wrong(radius=1025), "radius of 0 to 1024, got 1025"),
        (wrong(radius=2**63 - 1), "radius of 0 to 1024, got 9223372036854775807"),
        (wrong(first=-(2**63), last=2**63 - 2), "at most 2\\^30 columns and residuals, got first -9223372036854775808"),
        (wrong(first=0, last=2**30), "at most 2\\^30 columns and residuals, got first 0, last 1073741824"),
    ]


def test_an_empty_map() -> None:
    assert anynet_ext.candidate_costs(random(2, 4, 0, 3), random(1, 1, 0, 3), 2, -2, 1, 1).shape == (1, 18, 0, 3)


def test_a_radius_beyond_the_map() -> None:
    """Is as good as one that reaches its borders."""
    features, disparity = random(2, 4, 6, 9), random(1, 1, 6, 9)
    far, near = (anynet_ext.candidate_costs(features, disparity, 2, -1, 1, radius) for radius in (1024, 9))
    assert torch.equal(far, near)


@pytest.mark.parametrize("volume", [anynet_ext.cost_volume, reference.cost_volume])
def test_the_reference_takes_batches(volume: Any) -> None:
    left, right = random(2, 3, 4, 5, 30)
    disparity = 5 * random(3, 1, 5, 30)
    batch = reference.candidate_costs(torch.cat([left, right]), disparity, 2, -2, 1, 2, volume=volume)
    for n in range(3):
        pair = torch.stack([left[n], right[n]])
        torch.testing.assert_close(
            batch[n : n + 1], anynet_ext.candidate_costs(pair, disparity[n : n + 1], 2, -2, 1, 2)
        )


def test_the_references_have_gradients() -> None:
    generator = torch.Generator().manual_seed(1)
    features = torch.randn(4, 2, 2, 4, generator=generator, dtype=torch.float64, requires_grad=True)
    disparity = 0.3 + torch.rand(2, 1, 2, 4, generator=generator, dtype=torch.float64).mul(0.4)
    disparity.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda f, d: reference.candidate_costs(f, d, 2, -1, 1, 1), (features, disparity), eps=1e-7, atol=1e-5
    )
    tensors = [torch.randn(2, k, 2, 3, generator=generator, dtype=torch.float64, requires_grad=True) for k in (5, 1, 2)]
    assert torch.autograd.gradcheck(lambda *each: reference.expected_disparity(*each, -1), tensors)


def expected_call(*shape: int) -> Call:
    def make() -> tuple[tuple[Any, ...], dict[str, Any]]:
        cost = 5 * random(*shape)
        cost[..., ::3] *= 100  # one residual alone
        return call(cost, random(1, 1, *shape[2:]), 10 * random(1, 2, *shape[2:]), -3)

    return make


class TestExpectedDisparity(InferenceOperator):
    op = "expected_disparity"
    cases: ClassVar = {
        "x".join(map(str, shape)): expected_call(*shape)
        for shape in [
            (1, 5, 4, 30),
            (1, 2, 1, 1),
            (1, 7, 5, 70),
            (1, 9, 3, 16),
            (1, 3, 40, 33),
            (1, 7, 60, 300),
            (1, 3, 0, 4),
        ]
    }
    errors: ClassVar = [
        (
            lambda: call(DISPARITY, DISPARITY, DISPARITY, 0),
            r"cost of shape \[1, 2 or more, H, W\], got \[1, 1, 3, 5\]",
        ),
        (
            lambda: call(FEATURES[:1], DISPARITY, DISPARITY, 0),
            r"offsets of shape \[1, 2, 3, 5\], got \[1, 1, 3, 5\]",
        ),
    ]


def test_nan_costs_stay_in_their_pixel() -> None:
    """Also under UBSan: no bits of a NaN exponent overflow."""
    cost, disparity, offsets = random(1, 5, 4, 30), random(1, 1, 4, 30), random(1, 2, 4, 30)
    expected = anynet_ext.expected_disparity(cost, disparity, offsets, 0)
    cost[0, 2, 1, 7] = torch.nan
    out = anynet_ext.expected_disparity(cost, disparity, offsets, 0)
    assert out.isnan().sum() == 1
    assert out[0, 0, 1, 7].isnan()
    assert torch.equal(out.nan_to_num(0), expected.where(~out.isnan(), 0))
