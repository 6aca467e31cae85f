"""The operators under test, and what the tests of this folder share."""

from __future__ import annotations

import mmap
import shutil
import subprocess
from pathlib import Path
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


IMPLEMENTATIONS = [
    Ops("anynet", "cpu"),
    pytest.param(Ops("anynet", "cuda"), marks=pytest.mark.cuda),
    # The CUDA kernels on the CPU (tests/cuda/emulator): `pytest tests/ops -m slow -k emulated`.
    pytest.param(Ops("anynet_cuda_emulated", "cpu"), marks=pytest.mark.slow),
]


@pytest.fixture(scope="session")
def emulated_operators() -> None:
    """Builds and loads the library that registers `torch.ops.anynet_cuda_emulated`."""
    ninja = shutil.which("ninja")
    if shutil.which("cmake") is None or ninja is None:
        pytest.skip("needs cmake and ninja")
    root = Path(__file__).parents[2]
    folder = root / "build" / "emulated"
    torch_folder = Path(torch.__file__).parent
    options = ["-GNinja", f"-DCMAKE_MAKE_PROGRAM={ninja}", "-DANYNET_CUDA=OFF", f"-DANYNET_TORCH_DIR={torch_folder}"]
    for command in (
        ["cmake", "-S", root, "-B", folder, *options],
        ["cmake", "--build", folder, "--target", "_C_cuda_emulated"],
    ):
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert done.returncode == 0, done.stdout
    torch.ops.load_library(folder / "tests" / "cuda" / "_C_cuda_emulated.so")


@pytest.fixture(params=IMPLEMENTATIONS, ids=repr)
def ops(request: pytest.FixtureRequest) -> Ops:
    """The implementation under test: every test that takes `ops` runs once for each of IMPLEMENTATIONS."""
    if request.param.namespace == "anynet_cuda_emulated":
        request.getfixturevalue("emulated_operators")
    if request.param.device == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a GPU and the CUDA build of torch")
    return request.param


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
