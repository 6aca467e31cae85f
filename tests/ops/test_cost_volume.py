"""cost_volume and cost_volume_affine_relu."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
import torch
from differentiable_operator import DifferentiableOperator
from hypothesis import given
from hypothesis import strategies as st
from inference_operator import Call, InferenceOperator, call, random
from kinks import EPSILONS, slopes, whole_disparities
from operator_cases import DTYPES, LARGE, TOLERANCES, Case, check_far, disparity_map, extreme_disparities
from strategies import few, offsets, seeds, sizes, spans
from torch import Tensor

from anynet_ext import reference

NAN, INF = torch.nan, torch.inf
IMAGE = torch.zeros(2, 3, 4, 5)
DISPARITY = torch.zeros(2, 1, 4, 5)


def _features(*shape: int) -> Tensor:
    return torch.randn(shape, dtype=torch.float64)


def _cost_volume(n: int, c: int, h: int, w: int, first: int, last: int) -> list[Case]:
    name = f"{n}x{c}x{h}x{w}[{first},{last}]"

    def plain() -> list[Tensor | None]:
        return [_features(n, c, h, w), _features(n, c, h, w), None]

    def around() -> list[Tensor | None]:
        return [_features(n, c, h, w), _features(n, c, h, w), disparity_map(n, h, w, min(w, 12))]

    return [
        Case("cost_volume", plain, (first, last), name),
        Case("cost_volume", around, (first, last), f"{name}-disparity"),
    ]


class TestCostVolume(DifferentiableOperator):
    op = "cost_volume"
    # Odd and tiny sizes, ranges wider than the image or outside it, empty tensors, and sizes around a vector's length.
    cases: ClassVar = [
        *_cost_volume(2, 3, 4, 7, 0, 3),
        *_cost_volume(1, 1, 1, 1, 0, 0),
        *_cost_volume(1, 1, 1, 1, -2, 2),
        *_cost_volume(2, 2, 3, 1, -1, 1),
        *_cost_volume(1, 3, 1, 9, 0, 11),
        *_cost_volume(1, 2, 2, 5, -7, -3),
        *_cost_volume(1, 4, 3, 37, 0, 11),
        *_cost_volume(1, 17, 2, 70, -2, 2),
        *_cost_volume(1, 2, 1, 130, 0, 47),
        *_cost_volume(1, 1, 2, 20, 30, 33),
        *_cost_volume(0, 3, 4, 5, 0, 2),
        *_cost_volume(2, 0, 3, 4, 0, 1),
        *_cost_volume(1, 2, 0, 4, 0, 1),
        *_cost_volume(1, 2, 3, 0, -1, 1),
    ]
    calls: ClassVar = [
        Case("cost_volume", lambda: [torch.randn(2, 3, 4, 9), torch.randn(2, 3, 4, 9), None], (0, 3), "plain"),
        Case(
            "cost_volume",
            lambda: [torch.randn(2, 3, 4, 9), torch.randn(2, 3, 4, 9), disparity_map(2, 4, 9, 4).float()],
            (-1, 1),
            "disparity",
        ),
    ]
    large_calls: ClassVar = [
        Case("cost_volume", lambda: [torch.randn(LARGE), torch.randn(LARGE), None], (0, 11), "plain"),
        Case(
            "cost_volume",
            lambda: [torch.randn(LARGE), torch.randn(LARGE), disparity_map(2, 61, 131, 12)],
            (-2, 2),
            "disparity",
        ),
    ]
    function_errors: ClassVar = [
        ((None, IMAGE), TypeError, "cost_volume: expected left to be a Tensor, got NoneType"),
        ((IMAGE, 3), TypeError, "cost_volume: expected right to be a Tensor, got int"),
        ((IMAGE, IMAGE, 3), TypeError, "cost_volume: expected disparity to be a Tensor, got int"),
        (
            (IMAGE.int(), IMAGE),
            TypeError,
            "cost_volume: expected left of dtype float32, float64, float16 or bfloat16, got torch.int32",
        ),
        ((IMAGE[0], IMAGE), ValueError, "cost_volume: expected left of shape [N, C, H, W], got [3, 4, 5]"),
        (
            (IMAGE, IMAGE[..., :4]),
            ValueError,
            "cost_volume: expected right of shape [2, 3, 4, 5], got [2, 3, 4, 4]",
        ),
        (
            (IMAGE, IMAGE, IMAGE),
            ValueError,
            "cost_volume: expected disparity of shape [2, 1, 4, 5], got [2, 3, 4, 5]",
        ),
        (
            (IMAGE, IMAGE.double()),
            TypeError,
            "cost_volume: expected all tensors of one dtype, got torch.float32 and, for right, torch.float64",
        ),
        (
            (IMAGE, IMAGE, DISPARITY.half()),
            TypeError,
            "cost_volume: expected all tensors of one dtype, got torch.float32 and, for disparity, torch.float16",
        ),
        (
            (IMAGE, IMAGE.to("meta")),
            ValueError,
            "cost_volume: expected all tensors on one device, got cpu and, for right, meta",
        ),
        (
            (IMAGE, IMAGE, None, 3, 2),
            ValueError,
            "cost_volume: expected first <= last, got first 3 and last 2",
        ),
        ((IMAGE, IMAGE, None, 0.5, 2), TypeError, "cost_volume: expected first to be an int, got float"),
        ((IMAGE, IMAGE, None, 0, True), TypeError, "cost_volume: expected last to be an int, got bool"),
    ]
    operator_errors: ClassVar = [
        (
            "cost_volume",
            (IMAGE[0], IMAGE, None, 0, 1),
            "cost_volume: expected left of shape [N, C, H, W], got [3, 4, 5]",
        ),
        (
            "cost_volume",
            (IMAGE, IMAGE[:1], None, 0, 1),
            "cost_volume: expected right of shape [2, 3, 4, 5], got [1, 3, 4, 5]",
        ),
        (
            "cost_volume",
            (IMAGE, IMAGE.double(), None, 0, 1),
            "cost_volume: expected all tensors of one dtype, got float32 and, for right, float64",
        ),
        (
            "cost_volume",
            (IMAGE, IMAGE, IMAGE, 0, 1),
            "cost_volume: expected disparity of shape [2, 1, 4, 5], got [2, 3, 4, 5]",
        ),
        ("cost_volume", (IMAGE, IMAGE, None, 1, 0), "cost_volume: expected first <= last, got first 1 and last 0"),
        (
            "cost_volume",
            (IMAGE.int(), IMAGE.int(), None, 0, 1),
            "cost_volume: expected a tensor of dtype float32, float64, float16 or bfloat16, got int32",
        ),
        (
            "cost_volume_backward",
            (IMAGE, IMAGE, IMAGE, None, 0, 1),
            "cost_volume_backward: expected grad of shape [2, 2, 4, 5], got [2, 3, 4, 5]",
        ),
        (
            "cost_volume_backward",
            (IMAGE[:, :2].half(), IMAGE, IMAGE, None, 0, 1),
            "cost_volume_backward: expected all tensors of one dtype, got float32 and, for grad, float16",
        ),
        (
            "cost_volume",
            (IMAGE, IMAGE, None, -(2**63), 2**63 - 1),
            "cost_volume: expected at most 2^30 columns and offsets, "
            "got first -9223372036854775808, last 9223372036854775807 and left [2, 3, 4, 5]",
        ),
        (
            "cost_volume",
            (IMAGE, IMAGE, None, 0, 2**30),
            "cost_volume: expected at most 2^30 columns and offsets, "
            "got first 0, last 1073741824 and left [2, 3, 4, 5]",
        ),
        (
            "cost_volume_backward",
            (IMAGE, IMAGE, IMAGE, None, -(2**63), 2**63 - 2),
            "cost_volume: expected at most 2^30 columns and offsets, "
            "got first -9223372036854775808, last 9223372036854775806 and left [2, 3, 4, 5]",
        ),
    ]


def volume_call(shape: tuple[int, ...], groups: int, around: bool) -> Call:
    def make() -> tuple[tuple[Any, ...], dict[str, Any]]:
        disparity = 3 * random(1, 1, *shape[2:]).expand(shape[0], -1, -1, -1).contiguous() if around else None
        affine = random(groups), random(groups + 1)[1:].clone()
        return call(random(*shape), random(*shape) + 1, disparity, -1, 6, *affine)

    return make


PAIR = random(2, 1, 2, 2), random(2, 1, 2, 2)


class TestCostVolumeAffineRelu(InferenceOperator):
    op = "cost_volume_affine_relu"
    any_layout = ("right", "disparity")
    cases: ClassVar = {
        f"{shape}-{groups}-{around}": volume_call(shape, groups, around)
        for shape in [(2, 3, 5, 70), (4, 1, 1, 1), (0, 2, 3, 4), (2, 2, 3, 0), (2, 8, 46, 154)]
        for groups in (1, 2)
        for around in (True, False)
    }
    errors: ClassVar = [
        (
            lambda: call(random(3, 1, 2, 2), random(3, 1, 2, 2), None, 0, 3, random(2), random(2)),
            r"a scale for each of left's groups, got 2 for left \[3, 1, 2, 2\]",
        ),
        (
            lambda: call(*PAIR, None, 3, 0, random(2), random(2)),
            "cost_volume_affine_relu: expected first <= last, got first 3 and last 0",
        ),
        (
            lambda: call(*PAIR, None, -(2**63), 2**63 - 1, random(2), random(2)),
            "cost_volume_affine_relu: expected at most 2\\^30 columns and offsets, got first -9223372036854775808",
        ),
        (lambda: call(*PAIR, None, 0, 3, random(0), random(0)), "a scale for each of left's groups, got 0"),
        (lambda: call(*PAIR, None, 0, 3, random(2), random(1)), r"shift of shape \[2\], got \[1\]"),
    ]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
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


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_extreme_disparities(ops, dtype):
    """NaN gives NaN at its pixel; what lies outside, however far, gives the cost of comparing with zero."""
    special = extreme_disparities(dtype)
    w = len(special)
    left, right = torch.randn(2, 1, 2, 3, w, dtype=torch.float64).to(dtype).unbind(0)
    disparity = special.expand(1, 1, 3, w)
    args = [t.to(ops.device) for t in (left, right, disparity)]
    volume = ops.cost_volume(*args, -2, 2).cpu()
    wide = [t.double() for t in (left, right, disparity)]
    expected = reference.cost_volume(*wide, -2, 2)
    torch.testing.assert_close(volume, expected.to(dtype), equal_nan=True, **TOLERANCES[dtype])
    assert volume.isnan().equal(disparity.isnan().expand_as(volume))


@pytest.mark.parametrize("offset", [10**9, -(10**9), 10**12, -(10**12), 2**62, -(2**62)])
def test_extreme_offsets(ops, offset):
    """Ranges far outside compare with zero; int64 offsets do not wrap around."""
    left, right = torch.randn(2, 1, 2, 3, 9, device=ops.device).unbind(0)
    outside = left.abs().sum(1, keepdim=True).expand(1, 3, 3, 9)
    torch.testing.assert_close(ops.cost_volume(left, right, None, offset, offset + 2), outside)
    disparity = torch.randn(1, 1, 3, 9, device=ops.device)
    torch.testing.assert_close(ops.cost_volume(left, right, disparity, offset, offset + 2), outside)


def test_nan_disparity_passes_no_gradient(ops):
    image = torch.randn(1, 2, 3, 20, device=ops.device, requires_grad=True)
    disparity = torch.rand(1, 1, 3, 20, device=ops.device)
    disparity[..., ::3] = NAN
    disparity.requires_grad_()
    leaves = [image, disparity]
    # A disparity that leads outside passes no gradient either.
    known = disparity.detach().nan_to_num(100.0).requires_grad_()
    volume_grad = torch.randn(1, 2, 3, 20, device=ops.device)
    got = torch.autograd.grad(ops.cost_volume(image, image.detach(), disparity, 0, 1), leaves, volume_grad)
    volume_grad = torch.where(disparity.isnan(), 0, volume_grad)
    volume = reference.cost_volume(image, image.detach(), known, 0, 1)
    expected = torch.autograd.grad(volume, [image, known], volume_grad)
    torch.testing.assert_close(got[0], expected[0])
    torch.testing.assert_close(got[1], expected[1])
    torch.testing.assert_close(got[1], torch.where(disparity.isnan(), 0, expected[1]))


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_special_pixels(ops, dtype, value):
    """A special pixel reaches exactly the outputs that read it."""
    left, right = torch.randn(2, 1, 2, 3, 40, dtype=torch.float64).to(dtype).unbind(0)
    disparity = (torch.randint(0, 4, (1, 1, 3, 40)) + 0.5).to(dtype)
    right = right.clone()
    right[0, 1, 1, ::17] = value
    args = [t.to(ops.device) for t in (left, right, disparity)]
    wide = [t.double() for t in (left, right, disparity)]
    for got, expected in [
        (ops.cost_volume(args[0], args[1], None, -1, 3), reference.cost_volume(wide[0], wide[1], None, -1, 3)),
        (ops.cost_volume(*args, -1, 3), reference.cost_volume(*wide, -1, 3)),
    ]:
        assert not expected.isfinite().all()
        torch.testing.assert_close(got.cpu(), expected.to(dtype), equal_nan=True, **TOLERANCES[dtype])


@pytest.mark.parametrize("dim", range(4))
@pytest.mark.parametrize("around", [False, True])
def test_strides_beyond_32_bits(ops, memory, around, dim):
    if ops.device != "cpu":
        pytest.skip("uses virtual memory of the CPU")
    shape = [3 if i == dim else 2 for i in range(4)]
    n, _, h, w = shape
    image, other = torch.randn(2, *shape).bfloat16().unbind(0)
    disparity = torch.rand(n, 1, h, w).bfloat16()

    def call(o, x: Tensor) -> Tensor:
        return o.cost_volume(x, other, disparity, 0, 1) if around else o.cost_volume(other, x, None, 0, 1)

    check_far(ops, memory, image, dim, call)


@few
@given(sizes, seeds, offsets, spans)
def test_cost_volume_equals_reference(ops, uniform, size, seed, first, span):
    n, c, h, w = size
    left, right = uniform(seed, n, c, h, w), uniform(seed + 1, n, c, h, w)
    disparity = uniform(seed + 2, n, 1, h, w, scale=8.0)
    for d in (None, disparity):
        expected = reference.cost_volume(left, right, d, first, first + span)
        torch.testing.assert_close(ops.cost_volume(left, right, d, first, first + span), expected)


@few
@given(sizes, seeds, offsets, spans)
def test_cost_volume_mirrored(ops, uniform, size, seed, first, span):
    """Seen in a mirror, with the views exchanged, the scene is the same: offset k at x costs what it costs at x - k."""
    left, right = uniform(seed, *size), uniform(seed + 1, *size)
    w = size[3]
    volume = ops.cost_volume(left, right, None, first, first + span)
    mirrored = ops.cost_volume(right.flip(-1), left.flip(-1), None, first, first + span).flip(-1)
    for k in range(span + 1):
        d = first + k
        inside = torch.tensor(range(max(0, d), min(w, w + d)), dtype=torch.long, device=left.device)
        torch.testing.assert_close(volume[:, k, :, inside], mirrored[:, k, :, inside - d])


@few
@given(sizes, seeds, st.integers(-3, 3))
def test_cost_volume_is_warp_and_difference(ops, uniform, size, seed, offset):
    n, _, h, w = size
    left, right, disparity = uniform(seed, *size), uniform(seed + 1, *size), uniform(seed + 2, n, 1, h, w, scale=4.0)
    volume = ops.cost_volume(left, right, disparity, offset, offset)
    by_hand = (left - ops.warp(right, disparity + offset)).abs().sum(1, keepdim=True)
    torch.testing.assert_close(volume, by_hand)
