"""Every instruction set that this machine can run, called directly on NumPy arrays, both passes and all types."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from operator_cases import CASES, DTYPES, TOLERANCES
from torch import Tensor

import anynet_ext
from anynet_ext import _kernels, reference

ISAS = [isa for isa in _kernels.Isa.__members__.values() if _kernels.isa_available(isa)]


def to_array(t: Tensor) -> np.ndarray:
    """bfloat16, which NumPy lacks, travels as its bits."""
    return t.view(torch.uint16).numpy() if t.dtype == torch.bfloat16 else t.numpy()


def from_array(a: np.ndarray) -> Tensor:
    t = torch.from_numpy(a)
    return t.view(torch.bfloat16) if t.dtype == torch.uint16 else t


def reversed_columns(a: np.ndarray) -> np.ndarray:
    """The same values through a negative stride."""
    return np.ascontiguousarray(a[..., ::-1])[..., ::-1]


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("isa", ISAS, ids=lambda isa: isa.name)
@pytest.mark.parametrize("case", CASES, ids=repr)
def test_kernels(case, isa, dtype):
    tensors = case.tensors(dtype)
    wide = [None if t is None else t.double().clone().requires_grad_() for t in tensors]
    expected = case.run(reference, wide)
    grad = torch.randn_like(expected).to(dtype)
    inputs = [t for t in wide if t is not None]
    expected_grads = torch.autograd.grad(expected, inputs, grad.double(), materialize_grads=True)

    arrays = [None if t is None else reversed_columns(to_array(t)) for t in tensors]
    out = getattr(_kernels, case.op)(isa, *arrays, *case.numbers, 2)
    torch.testing.assert_close(from_array(out).double(), expected.detach(), **TOLERANCES[dtype])
    extra = [out] if case.op == "spatial_propagation" else []
    backward = getattr(_kernels, f"{case.op}_backward")
    grads = backward(isa, reversed_columns(to_array(grad)), *arrays, *extra, *case.numbers, 2)
    grads = [g for g in (grads if isinstance(grads, tuple) else (grads,)) if g is not None]
    for i, (one, other) in enumerate(zip(grads, expected_grads, strict=True)):
        tolerance = dict(TOLERANCES[dtype])
        if case.op == "spatial_propagation" and i == 1:  # reads the forward pass's rounded result
            tolerance["atol"] = tolerance["rtol"] * 16
        torch.testing.assert_close(from_array(one).double(), other, **tolerance)


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


def chosen(isa: str) -> subprocess.CompletedProcess[str]:
    """What a fresh process chooses when the environment asks for `isa`."""
    code = "import _kernels; print(_kernels.chosen_isa().name)"
    environment = {**os.environ, "ANYNET_ISA": isa, "PYTHONPATH": str(Path(_kernels.__file__).parent)}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("isa", [isa.name for isa in ISAS])
def test_environment_chooses(isa):
    assert chosen(isa).stdout.strip() == isa


def test_environment_names_an_unknown_set():
    message = chosen("mmx").stderr
    assert "ANYNET_ISA=mmx: expected one of" in message
    assert all(isa.name in message for isa in ISAS)


def test_best_is_the_default():
    assert chosen("").stdout.strip() == ISAS[-1].name
    assert anynet_ext.build_info()["instruction_set"] == _kernels.chosen_isa().name
