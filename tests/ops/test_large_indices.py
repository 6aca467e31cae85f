"""Elements beyond 2^31: the arithmetic is tested with views whose strides reach that far; little of it is touched."""

from __future__ import annotations

import mmap

import pytest
import torch
from torch import Tensor

from anynet_ext import reference

FAR = 2**31 + 64  # elements


@pytest.fixture(scope="module")
def memory() -> Tensor:
    """Virtual memory of 3 * FAR bfloat16 elements; pages that nobody touches cost nothing."""
    buffer = mmap.mmap(-1, 3 * FAR * 2, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | getattr(mmap, "MAP_NORESERVE", 0))
    return torch.frombuffer(buffer, dtype=torch.bfloat16)


def far(memory: Tensor, values: Tensor, dim: int) -> Tensor:
    """`values` as a view whose stride in `dim` is FAR."""
    strides = [0] * values.dim()
    step = 1
    for i in reversed(range(values.dim())):
        strides[i] = FAR if i == dim else step
        step *= 1 if i == dim else values.shape[i]
    view = memory.as_strided(values.shape, strides)
    view.copy_(values)
    return view


@pytest.mark.parametrize("dim", range(4))
@pytest.mark.parametrize("op", ["cost_volume", "cost_volume around", "warp", "soft_argmin", "spatial_propagation"])
def test_strides(ops, memory, op, dim):
    if ops.device != "cpu":
        pytest.skip("uses virtual memory of the CPU")
    shape = [3 if i == dim else 2 for i in range(4)]
    n, c, h, w = shape
    image, other = torch.randn(2, *shape).bfloat16().unbind(0)
    disparity = torch.rand(n, 1, h, w).bfloat16()
    gates = (torch.rand(n, 3, c, h, w) / 4).bfloat16()
    call = {
        "cost_volume": lambda o, x: o.cost_volume(other, x, None, 0, 1),
        "cost_volume around": lambda o, x: o.cost_volume(x, other, disparity, 0, 1),
        "warp": lambda o, x: o.warp(x, disparity),
        "soft_argmin": lambda o, x: o.soft_argmin(x, 0),
        "spatial_propagation": lambda o, x: o.spatial_propagation(x, gates, 0),
    }[op]
    leaf, plain = far(memory, image, dim).requires_grad_(), image.clone().requires_grad_()
    out, expected = call(ops, leaf), call(reference, plain)
    torch.testing.assert_close(out, expected)
    grad = torch.randn_like(expected)
    got = torch.autograd.grad(out, leaf, grad)[0]
    torch.testing.assert_close(got, torch.autograd.grad(expected, plain, grad)[0])


def test_far_gradient(ops, memory):
    if ops.device != "cpu":
        pytest.skip("uses virtual memory of the CPU")
    image = torch.randn(3, 2, 2, 3, dtype=torch.bfloat16, requires_grad=True)
    disparity = torch.rand(3, 1, 2, 3).bfloat16()
    grad = torch.randn(3, 2, 2, 3).bfloat16()
    (got,) = torch.autograd.grad(ops.warp(image, disparity), image, far(memory, grad, 0))
    torch.testing.assert_close(got, torch.autograd.grad(reference.warp(image, disparity), image, grad)[0])
