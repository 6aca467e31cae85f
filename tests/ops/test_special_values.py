"""NaN, infinities and extreme positions: they go where the formulas send them, and nowhere else."""

from __future__ import annotations

import pytest
import torch
from operator_cases import DTYPES, TOLERANCES

from anynet_ext import reference

NAN, INF = torch.nan, torch.inf


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_extreme_disparities(ops, dtype):
    """NaN gives NaN at its pixel; what lies outside, however far, gives the cost of comparing with zero."""
    special = torch.tensor([NAN, INF, -INF, 6e4, -6e4, 1.0, 0.0, -0.0, -1.0, NAN], dtype=dtype)
    if dtype != torch.float16:
        special = torch.cat([special, torch.tensor([1e30, -1e30, 3e9, -3e9, 3e38], dtype=dtype)])
    w = len(special)
    left, right = torch.randn(2, 1, 2, 3, w, dtype=torch.float64).to(dtype).unbind(0)
    disparity = special.expand(1, 1, 3, w)
    args = [t.to(ops.device) for t in (left, right, disparity)]
    volume, warped = ops.cost_volume(*args, -2, 2).cpu(), ops.warp(*args[1:]).cpu()
    wide = [t.double() for t in (left, right, disparity)]
    expected_volume, expected_warped = reference.cost_volume(*wide, -2, 2), reference.warp(*wide[1:])
    torch.testing.assert_close(volume, expected_volume.to(dtype), equal_nan=True, **TOLERANCES[dtype])
    torch.testing.assert_close(warped, expected_warped.to(dtype), equal_nan=True, **TOLERANCES[dtype])
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
    grad = torch.randn(1, 2, 3, 20, device=ops.device)
    leaves = [image, disparity]
    got = torch.autograd.grad(ops.warp(image, disparity), leaves, grad)
    # A disparity that leads outside passes no gradient either.
    known = disparity.detach().nan_to_num(100.0).requires_grad_()
    expected = torch.autograd.grad(reference.warp(image, known), [image, known], grad)
    torch.testing.assert_close(got[0], expected[0])
    torch.testing.assert_close(got[1], torch.where(disparity.isnan(), 0, expected[1]))

    volume_grad = torch.randn(1, 2, 3, 20, device=ops.device)
    got = torch.autograd.grad(ops.cost_volume(image, image.detach(), disparity, 0, 1), leaves, volume_grad)
    volume_grad = torch.where(disparity.isnan(), 0, volume_grad)
    volume = reference.cost_volume(image, image.detach(), known, 0, 1)
    expected = torch.autograd.grad(volume, [image, known], volume_grad)
    torch.testing.assert_close(got[0], expected[0])
    torch.testing.assert_close(got[1], expected[1])


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
        (ops.warp(*args[1:]), reference.warp(*wide[1:])),
    ]:
        assert not expected.isfinite().all()
        torch.testing.assert_close(got.cpu(), expected.to(dtype), equal_nan=True, **TOLERANCES[dtype])


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize(
    ("costs", "expected"),
    [
        ([0.0, INF, INF], 5.0),
        ([INF, INF, 1.0], 7.0),
        ([INF, 2.0, 2.0], 6.5),
        ([60000.0, -60000.0, 60000.0], 6.0),
        ([-60000.0, -60000.0, 60000.0], 5.5),
        ([NAN, 0.0, 0.0], NAN),
        ([0.0, 0.0, NAN], NAN),
        ([INF, INF, INF], NAN),
        ([-INF, 0.0, 0.0], NAN),
    ],
)
def test_soft_argmin(ops, costs, expected, dtype):
    """Extreme costs neither overflow nor vanish; an undefined softmax is NaN, as PyTorch's."""
    cost = torch.randn(1, 3, 2, 21, dtype=torch.float64).to(dtype)
    cost[0, :, 1, 4] = torch.tensor(costs, dtype=dtype)
    leaf = cost.to(ops.device).requires_grad_()
    out = ops.soft_argmin(leaf, 5)
    grad = torch.autograd.grad(out.sum(), leaf)[0].cpu()
    plain = reference.soft_argmin(cost.double(), 5).to(dtype)
    torch.testing.assert_close(out.detach().cpu(), plain, equal_nan=True, **TOLERANCES[dtype])
    torch.testing.assert_close(plain[0, 0, 1, 4].item(), expected, equal_nan=True)
    grad[0, :, 1, 4] = 0
    assert grad.isfinite().all(), "the gradients of other pixels must not suffer"


@pytest.mark.parametrize("direction", range(4))
@pytest.mark.parametrize("value", [NAN, INF])
def test_spatial_propagation(ops, direction, value):
    input = torch.randn(1, 1, 9, 11, dtype=torch.float64)
    gates = torch.rand(1, 3, 1, 9, 11, dtype=torch.float64) * 0.3
    # Gates whose neighbour lies outside do not count, whatever they hold.
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
