"""Every operator equals `anynet_ext.reference`, forward and backward, whatever the sizes, dtypes and layouts."""

from __future__ import annotations

import pytest
import torch
from operator_cases import CASES, DTYPES, LAYOUTS, TOLERANCES, Case
from torch import Tensor

from anynet_ext import reference


def expected(case: Case, tensors: list[Tensor | None], grad: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Result and gradients of the reference, computed in float64 from the same values."""
    wide = [None if t is None else t.detach().cpu().double().requires_grad_() for t in tensors]
    out = case.run(reference, wide)
    inputs = [t for t in wide if t is not None]
    grads = torch.autograd.grad(out, inputs, grad.cpu().double(), materialize_grads=True)
    return out.detach(), list(grads)


def actual(ops, case: Case, tensors: list[Tensor | None], grad: Tensor) -> tuple[Tensor, list[Tensor]]:
    leaves = [None if t is None else t.detach().requires_grad_() for t in tensors]
    out = case.run(ops, leaves)
    return out.detach(), list(torch.autograd.grad(out, [t for t in leaves if t is not None], grad))


def check(ops, case: Case, dtype: torch.dtype, tensors: list[Tensor | None], grad: Tensor) -> None:
    out, grads = actual(ops, case, tensors, grad)
    expected_out, expected_grads = expected(case, tensors, grad)
    assert out.is_contiguous()
    # The reference stays in float64: rounded as well, it could land on the next number but one.
    assert out.dtype == dtype
    torch.testing.assert_close(out.cpu().double(), expected_out, **TOLERANCES[dtype])
    for i, (one, other) in enumerate(zip(grads, expected_grads, strict=True)):
        tolerance = dict(TOLERANCES[dtype])
        if case.op == "spatial_propagation" and i == 1:  # reads the forward pass's rounded result
            tolerance["atol"] = tolerance["rtol"] * 16
        assert one.dtype == dtype
        torch.testing.assert_close(one.cpu().double(), other, **tolerance)


def out_shape(case: Case, tensors: list[Tensor | None]) -> torch.Size:
    return case.run(reference, [None if t is None else t.detach() for t in tensors]).shape


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("case", CASES, ids=repr)
def test_sizes(ops, case, dtype):
    tensors = [None if t is None else t.to(ops.device) for t in case.tensors(dtype)]
    grad = torch.randn(out_shape(case, tensors), dtype=torch.float64).to(ops.device, dtype)
    check(ops, case, dtype, tensors, grad)


LAYOUT_CASES = [case for case in CASES if "2x3x4x7" in case.name or "37" in case.name]


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("case", LAYOUT_CASES, ids=repr)
def test_layouts(ops, case, layout, dtype):
    tensors = [None if t is None else LAYOUTS[layout](t.to(ops.device)) for t in case.tensors(dtype)]
    grad = torch.randn(out_shape(case, tensors), dtype=torch.float64).to(ops.device, dtype)
    check(ops, case, dtype, tensors, LAYOUTS[layout](grad))


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("case", LAYOUT_CASES, ids=repr)
def test_expanded(ops, case, dtype):
    """Stride 0: gradients as `sum().backward()` makes them, and inputs shared by the batch."""
    tensors = [None if t is None else t.to(ops.device) for t in case.tensors(dtype)]
    tensors = [None if t is None else t[:1].expand(2, *t.shape[1:]) for t in tensors]
    grad = torch.ones((), dtype=dtype, device=ops.device).expand(out_shape(case, tensors))
    check(ops, case, dtype, tensors, grad)


@pytest.mark.parametrize(
    "case", [case for case in CASES if "x130" not in case.name and "192" not in case.name], ids=repr
)
def test_gradcheck(ops, case):
    tensors = [None if t is None else t.to(ops.device).requires_grad_() for t in case.tensors(torch.float64)]
    if any(t is not None and t.numel() == 0 for t in tensors):
        pytest.skip("nothing to differentiate")
    assert torch.autograd.gradcheck(
        lambda *args: case.run(ops, list(args)), tensors, eps=1e-4, atol=1e-6, fast_mode=True
    )
