"""Properties that hold for all inputs, tried on random ones."""

from __future__ import annotations

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from anynet_ext import reference

sizes = st.tuples(st.integers(1, 2), st.integers(1, 5), st.integers(1, 5), st.integers(1, 40))
seeds = st.integers(0, 2**31)
offsets = st.integers(-12, 12)
spans = st.integers(0, 14)
directions = st.integers(0, 3)
few = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def random(ops):
    def make(seed: int, *shape: int, scale: float = 1.0) -> Tensor:
        generator = torch.Generator().manual_seed(seed)
        return (scale * torch.randn(shape, generator=generator, dtype=torch.float64)).to(ops.device)

    return make


@few
@given(sizes, seeds, offsets, spans)
def test_cost_volume_equals_reference(ops, random, size, seed, first, span):
    n, c, h, w = size
    left, right = random(seed, n, c, h, w), random(seed + 1, n, c, h, w)
    disparity = random(seed + 2, n, 1, h, w, scale=8.0)
    for d in (None, disparity):
        expected = reference.cost_volume(left, right, d, first, first + span)
        torch.testing.assert_close(ops.cost_volume(left, right, d, first, first + span), expected)


@few
@given(sizes, seeds, offsets, spans)
def test_cost_volume_mirrored(ops, random, size, seed, first, span):
    """Seen in a mirror, with the views exchanged, the scene is the same: offset k at x costs what it costs at x - k."""
    left, right = random(seed, *size), random(seed + 1, *size)
    w = size[3]
    volume = ops.cost_volume(left, right, None, first, first + span)
    mirrored = ops.cost_volume(right.flip(-1), left.flip(-1), None, first, first + span).flip(-1)
    for k in range(span + 1):
        d = first + k
        inside = torch.tensor(range(max(0, d), min(w, w + d)), dtype=torch.long, device=left.device)
        torch.testing.assert_close(volume[:, k, :, inside], mirrored[:, k, :, inside - d])


@few
@given(sizes, seeds, st.integers(-3, 3))
def test_cost_volume_is_warp_and_difference(ops, random, size, seed, offset):
    n, _, h, w = size
    left, right, disparity = random(seed, *size), random(seed + 1, *size), random(seed + 2, n, 1, h, w, scale=4.0)
    volume = ops.cost_volume(left, right, disparity, offset, offset)
    by_hand = (left - ops.warp(right, disparity + offset)).abs().sum(1, keepdim=True)
    torch.testing.assert_close(volume, by_hand)


@few
@given(sizes, seeds, st.integers(-45, 45))
def test_warp_by_whole_pixels_is_a_shift(ops, random, size, seed, shift):
    image = random(seed, *size)
    warped = ops.warp(image, torch.full_like(image[:, :1], shift))
    columns = torch.arange(size[3], device=image.device) - shift
    assert torch.equal(warped, reference._columns(image, columns))


@few
@given(sizes, seeds)
def test_warp_is_linear(ops, random, size, seed):
    n, _, h, w = size
    one, other, disparity = random(seed, *size), random(seed + 1, *size), random(seed + 2, n, 1, h, w, scale=6.0)
    both = ops.warp(2 * one - other, disparity)
    torch.testing.assert_close(both, 2 * ops.warp(one, disparity) - ops.warp(other, disparity))


@few
@given(sizes, seeds)
def test_warp_gradient_is_its_adjoint(ops, random, size, seed):
    n, _, h, w = size
    image, disparity = random(seed, *size).requires_grad_(), random(seed + 1, n, 1, h, w, scale=6.0)
    grad = random(seed + 2, *size)
    out = ops.warp(image, disparity)
    (back,) = torch.autograd.grad(out, image, grad)
    torch.testing.assert_close((out * grad).sum(), (image * back).sum())


@few
@given(sizes, seeds, offsets, st.floats(-50, 50))
def test_soft_argmin(ops, random, size, seed, first, constant):
    """Within the range, moved by `first`, and blind to a constant; its gradients sum to zero."""
    cost = random(seed, *size, scale=5.0).requires_grad_()
    out = ops.soft_argmin(cost, first)
    assert (out >= first - 1e-9).all()
    assert (out <= first + size[1] - 1 + 1e-9).all()
    torch.testing.assert_close(out, ops.soft_argmin(cost, 0) + first)
    torch.testing.assert_close(out, ops.soft_argmin(cost + constant, first))
    (grad,) = torch.autograd.grad(out.sum(), cost)
    torch.testing.assert_close(grad.sum(1), torch.zeros_like(grad[:, 0]))


@few
@given(sizes, seeds, directions)
def test_spatial_propagation_keeps_constants(ops, random, size, seed, direction):
    n, c, h, w = size
    gates = random(seed, n, 3, c, h, w, scale=0.2)
    constant = torch.full(size, 3.25, dtype=torch.float64, device=gates.device)
    torch.testing.assert_close(ops.spatial_propagation(constant, gates, direction), constant)


@few
@given(sizes, seeds, directions)
def test_spatial_propagation_directions_are_mirror_images(ops, random, size, seed, direction):
    n, c, h, w = size
    image, gates = random(seed, *size), random(seed + 1, n, 3, c, h, w, scale=0.2)
    out = ops.spatial_propagation(image, gates, direction)
    torch.testing.assert_close(out, reference.spatial_propagation(image, gates, direction))
    axis = -1 if direction < 2 else -2
    flipped = ops.spatial_propagation(image.flip(axis), gates.flip(axis), direction ^ 1).flip(axis)
    assert torch.equal(out, flipped)
    turned = ops.spatial_propagation(image.mT, gates.mT, (direction + 2) % 4).mT
    torch.testing.assert_close(out, turned)
