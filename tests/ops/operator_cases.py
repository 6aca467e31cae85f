"""What the operators' tests are made of: cases, element types, memory layouts, instruction sets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from anynet_ext import _kernels, reference

ISAS = [isa for isa in _kernels.Isa.__members__.values() if _kernels.isa_available(isa)]
DTYPES = [torch.float32, torch.float64, torch.bfloat16, torch.float16]

# Half types are computed in float32 and rounded once: half a unit in the last place, and float32's own errors.
TOLERANCES = {
    torch.float64: {"rtol": 1e-11, "atol": 1e-11},
    torch.float32: {"rtol": 2e-5, "atol": 2e-5},
    torch.bfloat16: {"rtol": 2.0**-8, "atol": 1e-4},
    torch.float16: {"rtol": 2.0**-11, "atol": 1e-4},
}


def to_array(t: Tensor) -> np.ndarray:
    """bfloat16, which NumPy lacks, travels as its bits."""
    return t.view(torch.uint16).numpy() if t.dtype == torch.bfloat16 else t.numpy()


def from_array(a: np.ndarray) -> Tensor:
    t = torch.from_numpy(a)
    return t.view(torch.bfloat16) if t.dtype == torch.uint16 else t


LARGE = (2, 8, 61, 131)  # a shape for which several threads take part
FAR = 2**31 + 64  # elements


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


def check_far(ops: Any, memory: Tensor, image: Tensor, dim: int, call: Callable[[Any, Tensor], Tensor]) -> None:
    """`call(operators, image)` and its gradient are the reference's, with a stride of FAR in `dim`."""
    leaf, plain = far(memory, image, dim).requires_grad_(), image.clone().requires_grad_()
    out, expected = call(ops, leaf), call(reference, plain)
    torch.testing.assert_close(out, expected)
    grad = torch.randn_like(expected)
    got = torch.autograd.grad(out, leaf, grad)[0]
    torch.testing.assert_close(got, torch.autograd.grad(expected, plain, grad)[0])


def extreme_disparities(dtype: torch.dtype) -> Tensor:
    """NaN, infinities, both zeros, and what lies far outside any image."""
    nan, inf = torch.nan, torch.inf
    special = torch.tensor([nan, inf, -inf, 6e4, -6e4, 1.0, 0.0, -0.0, -1.0, nan], dtype=dtype)
    if dtype != torch.float16:
        special = torch.cat([special, torch.tensor([1e30, -1e30, 3e9, -3e9, 3e38], dtype=dtype)])
    return special


@dataclass(frozen=True)
class Case:
    """One call: `op(*make(), *numbers)`. `make` gives float64 tensors away from the kinks of floor and sign."""

    op: str
    make: Callable[[], list[Tensor | None]]
    numbers: tuple[int, ...]
    name: str

    def __repr__(self) -> str:
        return f"{self.op}-{self.name}"

    def tensors(self, dtype: torch.dtype) -> list[Tensor | None]:
        """The same values each time."""
        return [None if t is None else t.clone() for t in _settled_tensors(self, dtype)]

    def run(self, ops: Any, tensors: list[Tensor | None]) -> Tensor:
        return getattr(ops, self.op)(*tensors, *self.numbers)


@cache  # finding them takes longer than most of the tests
def _settled_tensors(case: Case, dtype: torch.dtype) -> list[Tensor | None]:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        return settled(case.op, [None if t is None else t.to(dtype) for t in case.make()], case.numbers)


def settled(op: str, tensors: list[Tensor | None], numbers: tuple[int, ...]) -> list[Tensor | None]:
    """For cost_volume, moves left pixels that nearly equal a right sample, where the sign of a difference is unsure."""
    if op != "cost_volume" or tensors[0] is None or tensors[0].numel() == 0:
        return tensors
    left, right, disparity = tensors
    assert right is not None
    wide = [right.double(), None if disparity is None else disparity.double()]
    for _ in range(200):
        near = torch.zeros_like(left, dtype=torch.bool)
        for offset in range(numbers[0], numbers[1] + 1):
            for c in range(left.shape[1]):
                difference = reference.cost_volume(
                    left[:, c : c + 1].double(), wide[0][:, c : c + 1], wide[1], offset, offset
                )
                near[:, c : c + 1] |= difference < 2e-3
        if not near.any():
            return [left, right, disparity]
        left = torch.where(near, left + 0.046875, left)
    raise AssertionError("no inputs away from the kinks found")


def disparity_map(n: int, h: int, w: int, reach: float) -> Tensor:
    """Disparities in [-reach, reach], at least 0.1 away from integers; some far outside."""
    d = torch.randint(-int(reach), int(reach) + 1, (n, 1, h, w), dtype=torch.float64)
    d += 0.125 * torch.randint(1, 8, (n, 1, h, w), dtype=torch.float64)
    return torch.where(torch.rand(n, 1, h, w) < 0.02, d * 100, d)


def _sliced(t: Tensor) -> Tensor:
    """Every second element of a larger tensor that holds NaN elsewhere."""
    big = torch.full([2 * size + 3 for size in t.shape], torch.nan, dtype=t.dtype, device=t.device)
    view = big[tuple(slice(2, 2 + 2 * size, 2) for size in t.shape)]
    view.copy_(t)
    return view


def _channels_last(t: Tensor) -> Tensor:
    return t.contiguous(memory_format=torch.channels_last if t.dim() == 4 else torch.channels_last_3d)


def _transposed(t: Tensor) -> Tensor:
    return t.transpose(-1, -2).contiguous().transpose(-1, -2)


LAYOUTS: dict[str, Callable[[Tensor], Tensor]] = {
    "contiguous": torch.Tensor.contiguous,
    "channels_last": _channels_last,
    "transposed": _transposed,
    "sliced": _sliced,
}
