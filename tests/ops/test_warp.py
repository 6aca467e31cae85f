"""warp."""

from __future__ import annotations

from typing import ClassVar

import pytest
import torch
from differentiable_operator import DifferentiableOperator
from hypothesis import given
from hypothesis import strategies as st
from kinks import EPSILONS, slopes, whole_disparities
from operator_cases import DTYPES, LARGE, TOLERANCES, Case, check_far, disparity_map, extreme_disparities, far
from strategies import few, seeds, sizes
from torch import Tensor

from anynet_ext import reference

NAN, INF = torch.nan, torch.inf
IMAGE = torch.zeros(2, 3, 4, 5)
DISPARITY = torch.zeros(2, 1, 4, 5)


def _features(*shape: int) -> Tensor:
    return torch.randn(shape, dtype=torch.float64)


def _warp(n: int, c: int, h: int, w: int) -> Case:
    return Case("warp", lambda: [_features(n, c, h, w), disparity_map(n, h, w, min(w, 12))], (), f"{n}x{c}x{h}x{w}")


class TestWarp(DifferentiableOperator):
    op = "warp"
    # Odd and tiny sizes, ranges wider than the image or outside it, empty tensors, and sizes around a vector's length.
    cases: ClassVar = [
        *[_warp(*shape) for shape in [(2, 3, 4, 7), (1, 1, 1, 1), (2, 1, 3, 2), (1, 4, 3, 37), (1, 17, 2, 70)]],
        *[_warp(*shape) for shape in [(1, 3, 1, 130), (0, 2, 3, 4), (1, 0, 2, 3), (2, 1, 0, 3), (1, 2, 3, 0)]],
    ]
    calls: ClassVar = [
        Case("warp", lambda: [torch.randn(2, 3, 4, 9), disparity_map(2, 4, 9, 4).float()], (), ""),
    ]
    large_calls: ClassVar = [
        Case("warp", lambda: [torch.randn(LARGE), disparity_map(2, 61, 131, 12)], (), ""),
    ]
    function_errors: ClassVar = [
        (([], DISPARITY), TypeError, "warp: expected image to be a Tensor, got list"),
        (
            (IMAGE.bool(), DISPARITY),
            TypeError,
            "warp: expected image of dtype float32, float64, float16 or bfloat16, got torch.bool",
        ),
        ((IMAGE[0, 0], DISPARITY), ValueError, "warp: expected image of shape [N, C, H, W], got [4, 5]"),
        ((IMAGE, None), TypeError, "warp: expected disparity to be a Tensor, got NoneType"),
        ((IMAGE, DISPARITY[:1]), ValueError, "warp: expected disparity of shape [2, 1, 4, 5], got [1, 1, 4, 5]"),
        ((IMAGE, DISPARITY[:, 0]), ValueError, "warp: expected disparity of shape [2, 1, 4, 5], got [2, 4, 5]"),
        (
            (IMAGE, DISPARITY.bfloat16()),
            TypeError,
            "warp: expected all tensors of one dtype, got torch.float32 and, for disparity, torch.bfloat16",
        ),
        (
            (IMAGE, DISPARITY.to("meta")),
            ValueError,
            "warp: expected all tensors on one device, got cpu and, for disparity, meta",
        ),
    ]
    operator_errors: ClassVar = [
        ("warp", (IMAGE[0], DISPARITY), "warp: expected image of shape [N, C, H, W], got [3, 4, 5]"),
        ("warp", (IMAGE, IMAGE), "warp: expected disparity of shape [2, 1, 4, 5], got [2, 3, 4, 5]"),
        (
            "warp_backward",
            (DISPARITY, IMAGE, DISPARITY),
            "warp_backward: expected grad of shape [2, 3, 4, 5], got [2, 1, 4, 5]",
        ),
    ]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
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


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_extreme_disparities(ops, dtype):
    """NaN gives NaN at its pixel; what lies outside, however far, gives zero."""
    special = extreme_disparities(dtype)
    w = len(special)
    image = torch.randn(1, 2, 3, w, dtype=torch.float64).to(dtype)
    disparity = special.expand(1, 1, 3, w)
    args = [t.to(ops.device) for t in (image, disparity)]
    warped = ops.warp(*args).cpu()
    wide = [t.double() for t in (image, disparity)]
    expected = reference.warp(*wide)
    torch.testing.assert_close(warped, expected.to(dtype), equal_nan=True, **TOLERANCES[dtype])
    assert warped.isnan().equal(disparity.isnan().expand_as(warped))


def test_nan_disparity_passes_no_gradient(ops):
    image = torch.randn(1, 2, 3, 20, device=ops.device, requires_grad=True)
    disparity = torch.rand(1, 1, 3, 20, device=ops.device)
    disparity[..., ::3] = NAN
    disparity.requires_grad_()
    grad = torch.randn(1, 2, 3, 20, device=ops.device)
    leaves = [image, disparity]
    got = torch.autograd.grad(ops.warp(image, disparity), leaves, grad)
    # A disparity that leads outside passes no gradient either.
    known = disparity.detach().nan_to_num(100.0).requires_grad_()
    expected = torch.autograd.grad(reference.warp(image, known), [image, known], grad)
    torch.testing.assert_close(got[0], expected[0])
    torch.testing.assert_close(got[1], torch.where(disparity.isnan(), 0, expected[1]))


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_special_pixels(ops, dtype, value):
    """A special pixel reaches exactly the outputs that read it."""
    right = torch.randn(1, 2, 3, 40, dtype=torch.float64).to(dtype)
    disparity = (torch.randint(0, 4, (1, 1, 3, 40)) + 0.5).to(dtype)
    right = right.clone()
    right[0, 1, 1, ::17] = value
    args = [t.to(ops.device) for t in (right, disparity)]
    wide = [t.double() for t in (right, disparity)]
    got, expected = ops.warp(*args), reference.warp(*wide)
    assert not expected.isfinite().all()
    torch.testing.assert_close(got.cpu(), expected.to(dtype), equal_nan=True, **TOLERANCES[dtype])


@pytest.mark.parametrize("dim", range(4))
def test_strides_beyond_32_bits(ops, memory, dim):
    if ops.device != "cpu":
        pytest.skip("uses virtual memory of the CPU")
    shape = [3 if i == dim else 2 for i in range(4)]
    n, _, h, w = shape
    image = torch.randn(*shape).bfloat16()
    disparity = torch.rand(n, 1, h, w).bfloat16()

    def call(o, x: Tensor) -> Tensor:
        return o.warp(x, disparity)

    check_far(ops, memory, image, dim, call)


def test_far_gradient(ops, memory):
    if ops.device != "cpu":
        pytest.skip("uses virtual memory of the CPU")
    image = torch.randn(3, 2, 2, 3, dtype=torch.bfloat16, requires_grad=True)
    disparity = torch.rand(3, 1, 2, 3).bfloat16()
    grad = torch.randn(3, 2, 2, 3).bfloat16()
    (got,) = torch.autograd.grad(ops.warp(image, disparity), image, far(memory, grad, 0))
    torch.testing.assert_close(got, torch.autograd.grad(reference.warp(image, disparity), image, grad)[0])


@few
@given(sizes, seeds, st.integers(-45, 45))
def test_warp_by_whole_pixels_is_a_shift(ops, uniform, size, seed, shift):
    image = uniform(seed, *size)
    warped = ops.warp(image, torch.full_like(image[:, :1], shift))
    columns = torch.arange(size[3], device=image.device) - shift
    assert torch.equal(warped, reference._columns(image, columns))


@few
@given(sizes, seeds)
def test_warp_is_linear(ops, uniform, size, seed):
    n, _, h, w = size
    one, other, disparity = uniform(seed, *size), uniform(seed + 1, *size), uniform(seed + 2, n, 1, h, w, scale=6.0)
    both = ops.warp(2 * one - other, disparity)
    torch.testing.assert_close(both, 2 * ops.warp(one, disparity) - ops.warp(other, disparity))


@few
@given(sizes, seeds)
def test_warp_gradient_is_its_adjoint(ops, uniform, size, seed):
    n, _, h, w = size
    image, disparity = uniform(seed, *size).requires_grad_(), uniform(seed + 1, n, 1, h, w, scale=6.0)
    grad = uniform(seed + 2, *size)
    out = ops.warp(image, disparity)
    (back,) = torch.autograd.grad(out, image, grad)
    torch.testing.assert_close((out * grad).sum(), (image * back).sum())
