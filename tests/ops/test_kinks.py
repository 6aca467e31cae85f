"""At and near the points where derivatives jump: whole-pixel positions (floor) and equal features (sign).

Outside a thin band around them the other tests demand the derivative; inside it these demand one of the one-sided ones,
and exactly at the kink the value that the documentation names.
"""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from anynet_ext import reference

EPSILONS = [0.0, 1e-12, -1e-12, 1e-7, -1e-7, 1e-5, -1e-5, 1e-3, -1e-3]
DTYPES = [torch.float32, torch.float64]


def whole_disparities(dtype: torch.dtype) -> Tensor:
    """[1,1,4,23], so that positions lie before, in and behind the image."""
    return torch.randint(-25, 26, (1, 1, 4, 23)).to(dtype)


def slopes(image: Tensor, position: Tensor) -> tuple[Tensor, Tensor]:
    """The two one-sided derivatives of `image` sampled at whole `position`s: towards smaller and larger columns."""
    at = [reference._columns(image, position + step) for step in (-1, 0, 1)]
    return at[1] - at[0], at[2] - at[1]


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("epsilon", EPSILONS)
def test_warp_near_whole_positions(ops, epsilon, dtype):
    image = torch.randn(1, 3, 4, 23, dtype=dtype)
    exact = whole_disparities(dtype)
    leaf = (exact.double() + epsilon).to(dtype).to(ops.device).requires_grad_()
    out = ops.warp(image.to(ops.device), leaf)
    (grad,) = torch.autograd.grad(out.sum(), leaf)

    position = torch.arange(23) - exact
    at = reference._columns(image, position)
    torch.testing.assert_close(out.detach().cpu(), at, rtol=0, atol=8 * abs(epsilon) + 1e-12)
    if epsilon == 0:
        assert torch.equal(out.detach().cpu(), at), "sampling must be exact at whole positions"
    below, above = (-slope.sum(1, keepdim=True) for slope in slopes(image, position))
    grad = grad.cpu()
    if epsilon == 0:
        torch.testing.assert_close(grad, above)  # documented: towards larger columns
    else:
        assert (torch.isclose(grad, below, atol=1e-5) | torch.isclose(grad, above, atol=1e-5)).all()


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("epsilon", EPSILONS)
def test_cost_volume_near_whole_positions(ops, epsilon, dtype):
    right = torch.rand(1, 3, 4, 23, dtype=dtype)
    left = torch.full_like(right, 2)  # above every sample: the sign is sure
    exact = whole_disparities(dtype)
    leaf = (exact.double() + epsilon).to(dtype).to(ops.device).requires_grad_()
    out = ops.cost_volume(left.to(ops.device), right.to(ops.device), leaf, -1, 1)
    (grad,) = torch.autograd.grad(out.sum(), leaf)

    positions = [torch.arange(23) - exact - k for k in (-1, 0, 1)]
    expected = torch.cat([(left - reference._columns(right, p)).sum(1, keepdim=True) for p in positions], 1)
    torch.testing.assert_close(out.detach().cpu(), expected, rtol=1e-6, atol=8 * abs(epsilon) + 1e-12)
    below, above = (sum(slopes(right, p)[side].sum(1, keepdim=True) for p in positions) for side in (0, 1))
    grad = grad.cpu()
    if epsilon == 0:
        torch.testing.assert_close(grad, above, rtol=1e-5, atol=1e-5)
    else:
        assert (torch.isclose(grad, below, atol=1e-5) | torch.isclose(grad, above, atol=1e-5)).all()


@pytest.mark.parametrize("with_disparity", [False, True])
@pytest.mark.parametrize("epsilon", EPSILONS)
def test_cost_volume_near_equal_features(ops, epsilon, with_disparity):
    right = torch.randn(1, 1, 5, 31, dtype=torch.float64, device=ops.device)
    disparity = torch.full((1, 1, 5, 31), 1.5, dtype=torch.float64, device=ops.device) if with_disparity else None
    sampled = right if disparity is None else reference.warp(right, disparity)
    left = (sampled + epsilon).requires_grad_()
    out = ops.cost_volume(left, right, disparity, 0, 0)
    torch.testing.assert_close(out.detach(), torch.full_like(out, abs(epsilon)), rtol=0, atol=1e-15)
    (grad,) = torch.autograd.grad(out.sum(), left)
    if epsilon == 0:
        assert torch.equal(grad, torch.zeros_like(grad)), "the derivative of |.| at 0 is 0"
    else:
        assert torch.equal(grad, torch.full_like(grad, epsilon).sign())


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float16], ids=str)
def test_fraction_is_exact_far_from_the_origin(ops, dtype):
    """A disparity's fraction must not be lost in the rounding of x - disparity at large x."""
    ramp = torch.arange(3000, dtype=torch.float32) % 16
    image = ramp.expand(1, 1, 1, 3000).to(dtype).to(ops.device)
    disparity = torch.full_like(image, 2.0**-7)
    out = ops.warp(image, disparity).float()[0, 0, 0]
    step = image.float()[0, 0, 0]
    expected = (1 - 2.0**-7) * step[1:] + 2.0**-7 * step[:-1]
    torch.testing.assert_close(out[1:], expected.to(dtype).float(), rtol=0, atol=0)
