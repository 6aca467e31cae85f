"""The operators under test, and what the tests of this folder share."""

from __future__ import annotations

import mmap
from typing import Any

import pytest
import torch
from operator_cases import FAR
from torch import Tensor

import anynet_ext  # noqa: F401  (registers the operators)


class _Differentiable(torch.autograd.Function):
    """Any operator of a namespace, with its `_backward` as derivative."""

    @staticmethod
    def forward(ctx: Any, namespace: Any, name: str, *args: Any) -> Tensor:
        out = getattr(namespace, name)(*args)
        ctx.namespace, ctx.name = namespace, name
        ctx.rest = [None if isinstance(arg, Tensor) else arg for arg in args]
        ctx.save_for_backward(*[arg if isinstance(arg, Tensor) else None for arg in args], out)
        return out

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
        *tensors, out = ctx.saved_tensors
        args = [rest if tensor is None else tensor for tensor, rest in zip(tensors, ctx.rest, strict=True)]
        if ctx.name == "spatial_propagation":
            args.insert(2, out)
        grads = getattr(ctx.namespace, f"{ctx.name}_backward")(grad, *args)
        grads = iter([grads] if isinstance(grads, Tensor) else grads)
        return None, None, *[None if tensor is None else next(grads) for tensor in tensors]


class Ops:
    """The four operators of `torch.ops.<namespace>`, differentiable, for tensors on `device`.

    For the product's own namespace these are its registered derivatives; another namespace needs only the operators and
    their `_backward`s, with the same schemas.
    """

    def __init__(self, namespace: str, device: str) -> None:
        self.namespace, self.device = namespace, device

    def __repr__(self) -> str:
        return f"{self.namespace}-{self.device}"

    def _call(self, name: str, *args: Any) -> Tensor:
        namespace = getattr(torch.ops, self.namespace)
        if self.namespace == "anynet":
            return getattr(namespace, name)(*args)
        return _Differentiable.apply(namespace, name, *args)

    def cost_volume(self, left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int) -> Tensor:
        return self._call("cost_volume", left, right, disparity, first, last)

    def warp(self, image: Tensor, disparity: Tensor) -> Tensor:
        return self._call("warp", image, disparity)

    def soft_argmin(self, cost: Tensor, first: int) -> Tensor:
        return self._call("soft_argmin", cost, first)

    def spatial_propagation(self, input: Tensor, gates: Tensor, direction: int) -> Tensor:
        return self._call("spatial_propagation", input, gates, direction)


CUDA_IMPLEMENTATIONS = [
    pytest.param(Ops("anynet", "cuda"), marks=pytest.mark.cuda),
    # The CUDA kernels on the CPU (tests/cuda/emulator): `pytest tests/ops -m slow -k emulated`.
    pytest.param(Ops("anynet_cuda_emulated", "cpu"), marks=pytest.mark.slow),
]
IMPLEMENTATIONS = [Ops("anynet", "cpu"), *CUDA_IMPLEMENTATIONS]


def _available(request: pytest.FixtureRequest) -> Ops:
    if request.param.namespace == "anynet_cuda_emulated":
        request.getfixturevalue("emulated_operators")
    if request.param.device == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a GPU and the CUDA build of torch")
    return request.param


@pytest.fixture(params=IMPLEMENTATIONS, ids=repr)
def ops(request: pytest.FixtureRequest) -> Ops:
    """The implementation under test: every test that takes `ops` runs once for each of IMPLEMENTATIONS."""
    return _available(request)


@pytest.fixture(params=CUDA_IMPLEMENTATIONS, ids=repr)
def cuda(request: pytest.FixtureRequest) -> Ops:
    """The same for what the CPU's tests test another way."""
    return _available(request)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """The values of a test's parameter `case` are its class's `cases`, and so on for every such pair of names."""
    for name in metafunc.fixturenames:
        values = getattr(metafunc.cls, f"{name}s", None)
        if isinstance(values, dict):
            metafunc.parametrize(name, values.values(), ids=values.keys())
        elif isinstance(values, list):  # of cases, or of wrong calls with their message
            ids = [value[-1] if isinstance(value, tuple) else repr(value) for value in values]
            metafunc.parametrize(name, values, ids=ids)


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def memory() -> Tensor:
    """Virtual memory of 3 * FAR bfloat16 elements; pages that nobody touches cost nothing."""
    buffer = mmap.mmap(-1, 3 * FAR * 2, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | getattr(mmap, "MAP_NORESERVE", 0))
    return torch.frombuffer(buffer, dtype=torch.bfloat16)


@pytest.fixture
def uniform(ops):
    def make(seed: int, *shape: int, scale: float = 1.0) -> Tensor:
        generator = torch.Generator().manual_seed(seed)
        return (scale * torch.randn(shape, generator=generator, dtype=torch.float64)).to(ops.device)

    return make


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(20180)
