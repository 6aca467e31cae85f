"""soft_argmin."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest
import torch
from differentiable_operator import DifferentiableOperator
from hypothesis import given
from hypothesis import strategies as st
from operator_cases import DTYPES, ISAS, LARGE, TOLERANCES, Case, check_far
from strategies import few, offsets, seeds, sizes
from torch import Tensor

from anynet_ext import _kernels, reference

NAN, INF = torch.nan, torch.inf
IMAGE = torch.zeros(2, 3, 4, 5)
GATES = torch.zeros(2, 3, 3, 4, 5)


def _features(*shape: int) -> Tensor:
    return torch.randn(shape, dtype=torch.float64)


def _soft_argmin(n: int, d: int, h: int, w: int, first: int) -> Case:
    return Case("soft_argmin", lambda: [3 * _features(n, d, h, w)], (first,), f"{n}x{d}x{h}x{w}[{first}]")


class TestSoftArgmin(DifferentiableOperator):
    op = "soft_argmin"
    # Odd and tiny sizes, ranges wider than the image or outside it, empty tensors, and sizes around a vector's length.
    cases: ClassVar = [
        *[
            _soft_argmin(*shape)
            for shape in [(2, 3, 4, 7, 0), (1, 1, 1, 1, -4), (1, 12, 3, 37, -2), (2, 5, 1, 70, 100)]
        ],
        *[_soft_argmin(*shape) for shape in [(1, 192, 2, 19, 0), (0, 3, 4, 5, 0), (1, 3, 0, 5, 0), (1, 3, 5, 0, 1)]],
    ]
    calls: ClassVar = [
        Case("soft_argmin", lambda: [torch.randn(2, 3, 4, 9)], (1,), ""),
    ]
    large_calls: ClassVar = [
        Case("soft_argmin", lambda: [torch.randn(LARGE)], (0,), ""),
    ]
    function_errors: ClassVar = [
        (("cost",), TypeError, "soft_argmin: expected cost to be a Tensor, got str"),
        (
            (IMAGE.long(),),
            TypeError,
            "soft_argmin: expected cost of dtype float32, float64, float16 or bfloat16, got torch.int64",
        ),
        ((GATES,), ValueError, "soft_argmin: expected cost of shape [N, D, H, W], got [2, 3, 3, 4, 5]"),
        (
            (IMAGE[:, :0],),
            ValueError,
            "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got [2, 0, 4, 5]",
        ),
        ((IMAGE, 1.0), TypeError, "soft_argmin: expected first to be an int, got float"),
    ]
    operator_errors: ClassVar = [
        ("soft_argmin", (IMAGE[0], 0), "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got [3, 4, 5]"),
        (
            "soft_argmin",
            (IMAGE[:, :0], 0),
            "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got [2, 0, 4, 5]",
        ),
        (
            "soft_argmin_backward",
            (IMAGE, IMAGE, 0),
            "soft_argmin_backward: expected grad of shape [2, 1, 4, 5], got [2, 3, 4, 5]",
        ),
    ]


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
def test_extreme_costs(ops, costs, expected, dtype):
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


@pytest.mark.parametrize(("dtype", "reach"), [(np.float32, 86.0), (np.float64, 700.0)], ids=str)
@pytest.mark.parametrize("isa", ISAS, ids=lambda isa: isa.name)
def test_exponential(isa, dtype, reach):
    """The kernels' own exp, seen through two costs 0 and x: e^-x / (1 + e^-x) to 4 units in the last place."""
    x = np.linspace(0, reach, 100_003, dtype=dtype)
    cost = np.stack([np.zeros_like(x), x])[None, :, None]
    got = _kernels.soft_argmin(isa, cost, 0, 1).ravel().astype(np.longdouble)
    e = np.exp(-x.astype(np.longdouble))
    error = np.abs(got / (e / (1 + e)) - 1)
    assert error.max() < 4 * np.finfo(dtype).eps
    beyond = np.array([reach + 10, 1e4, np.inf], dtype=dtype)
    cost = np.stack([np.zeros_like(beyond), beyond])[None, :, None]
    assert not _kernels.soft_argmin(isa, cost, 0, 1).any()


@pytest.mark.parametrize("dim", range(4))
def test_strides_beyond_32_bits(ops, memory, dim):
    if ops.device != "cpu":
        pytest.skip("uses virtual memory of the CPU")
    shape = [3 if i == dim else 2 for i in range(4)]
    image = torch.randn(*shape).bfloat16()

    def call(o, x: Tensor) -> Tensor:
        return o.soft_argmin(x, 0)

    check_far(ops, memory, image, dim, call)


@few
@given(sizes, seeds, offsets, st.floats(-50, 50))
def test_properties(ops, uniform, size, seed, first, constant):
    """Within the range, moved by `first`, and blind to a constant; its gradients sum to zero."""
    cost = uniform(seed, *size, scale=5.0).requires_grad_()
    out = ops.soft_argmin(cost, first)
    assert (out >= first - 1e-9).all()
    assert (out <= first + size[1] - 1 + 1e-9).all()
    torch.testing.assert_close(out, ops.soft_argmin(cost, 0) + first)
    torch.testing.assert_close(out, ops.soft_argmin(cost + constant, first))
    (grad,) = torch.autograd.grad(out.sum(), cost)
    torch.testing.assert_close(grad.sum(1), torch.zeros_like(grad[:, 0]))
