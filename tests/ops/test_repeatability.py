"""Results repeat bit for bit, from run to run and for any number of threads."""

from __future__ import annotations

import pytest
import torch
from operator_cases import DTYPES, Case, disparity_map
from torch import Tensor

# Large enough that several threads take part.
SIZE = (2, 8, 61, 131)


def _tensors(op: str) -> list[Tensor | None]:
    n, c, h, w = SIZE
    image = torch.randn(SIZE)
    return {
        "cost_volume": [image, torch.randn(SIZE), disparity_map(n, h, w, 12)],
        "warp": [image, disparity_map(n, h, w, 12)],
        "soft_argmin": [image],
        "spatial_propagation": [image, torch.rand(n, 3, c, h, w) * 0.6 - 0.3],
    }[op]


CALLS = [
    Case("cost_volume", lambda: [*_tensors("cost_volume")[:2], None], (0, 11), "plain"),
    Case("cost_volume", lambda: _tensors("cost_volume"), (-2, 2), "disparity"),
    Case("warp", lambda: _tensors("warp"), (), ""),
    Case("soft_argmin", lambda: _tensors("soft_argmin"), (0,), ""),
    *[Case("spatial_propagation", lambda: _tensors("spatial_propagation"), (d,), "LRTB"[d]) for d in range(4)],
]


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("call", CALLS, ids=repr)
def test_bit_equality(ops, call, dtype, threads):
    tensors = [None if t is None else t.to(ops.device, dtype).requires_grad_() for t in call.make()]
    leaves = [t for t in tensors if t is not None]
    grad = None
    expected = None
    for count in (1, 1, 2, 3, 7, 2):
        threads(count)
        out = call.run(ops, tensors)
        grad = torch.randn_like(out) if grad is None else grad
        results = [out.detach(), *torch.autograd.grad(out, leaves, grad)]
        expected = results if expected is None else expected
        for one, other in zip(results, expected, strict=True):
            assert torch.equal(one, other), f"{count} threads"
