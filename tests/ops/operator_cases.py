"""Inputs for the operators' tests: one list of cases per operator, and the memory layouts to lay them out in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from anynet_ext import reference

DTYPES = [torch.float32, torch.float64, torch.bfloat16, torch.float16]

# Half types are computed in float32 and rounded once: half a unit in the last place, and float32's own errors.
TOLERANCES = {
    torch.float64: {"rtol": 1e-11, "atol": 1e-11},
    torch.float32: {"rtol": 2e-5, "atol": 2e-5},
    torch.bfloat16: {"rtol": 2.0**-8, "atol": 1e-4},
    torch.float16: {"rtol": 2.0**-11, "atol": 1e-4},
}


@dataclass
class Case:
    """One call: `op(*make(), *numbers)`. `make` gives float64 tensors away from the kinks of floor and sign."""

    op: str
    make: Callable[[], list[Tensor | None]]
    numbers: tuple[int, ...]
    name: str

    def __repr__(self) -> str:
        return f"{self.op}-{self.name}"

    def tensors(self, dtype: torch.dtype) -> list[Tensor | None]:
        return settled(self.op, [None if t is None else t.to(dtype) for t in self.make()], self.numbers)

    def run(self, ops: Any, tensors: list[Tensor | None]) -> Tensor:
        return getattr(ops, self.op)(*tensors, *self.numbers)


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


def _features(*shape: int) -> Tensor:
    return torch.randn(shape, dtype=torch.float64)


def _cost_volume(n: int, c: int, h: int, w: int, first: int, last: int) -> list[Case]:
    name = f"{n}x{c}x{h}x{w}[{first},{last}]"

    def plain() -> list[Tensor | None]:
        return [_features(n, c, h, w), _features(n, c, h, w), None]

    def around() -> list[Tensor | None]:
        return [_features(n, c, h, w), _features(n, c, h, w), disparity_map(n, h, w, min(w, 12))]

    return [
        Case("cost_volume", plain, (first, last), name),
        Case("cost_volume", around, (first, last), f"{name}-disparity"),
    ]


def _warp(n: int, c: int, h: int, w: int) -> Case:
    return Case("warp", lambda: [_features(n, c, h, w), disparity_map(n, h, w, min(w, 12))], (), f"{n}x{c}x{h}x{w}")


def _soft_argmin(n: int, d: int, h: int, w: int, first: int) -> Case:
    return Case("soft_argmin", lambda: [3 * _features(n, d, h, w)], (first,), f"{n}x{d}x{h}x{w}[{first}]")


def _spatial_propagation(n: int, c: int, h: int, w: int) -> list[Case]:
    def make() -> list[Tensor | None]:
        return [_features(n, c, h, w), torch.rand(n, 3, c, h, w, dtype=torch.float64) * 0.6 - 0.3]

    return [Case("spatial_propagation", make, (d,), f"{n}x{c}x{h}x{w}-{'LRTB'[d]}") for d in range(4)]


# Odd and tiny sizes, ranges wider than the image or outside it, empty tensors, and sizes around a vector's length.
CASES: list[Case] = [
    *_cost_volume(2, 3, 4, 7, 0, 3),
    *_cost_volume(1, 1, 1, 1, 0, 0),
    *_cost_volume(1, 1, 1, 1, -2, 2),
    *_cost_volume(2, 2, 3, 1, -1, 1),
    *_cost_volume(1, 3, 1, 9, 0, 11),
    *_cost_volume(1, 2, 2, 5, -7, -3),
    *_cost_volume(1, 4, 3, 37, 0, 11),
    *_cost_volume(1, 17, 2, 70, -2, 2),
    *_cost_volume(1, 2, 1, 130, 0, 47),
    *_cost_volume(1, 1, 2, 20, 30, 33),
    *_cost_volume(0, 3, 4, 5, 0, 2),
    *_cost_volume(2, 0, 3, 4, 0, 1),
    *_cost_volume(1, 2, 0, 4, 0, 1),
    *_cost_volume(1, 2, 3, 0, -1, 1),
    *[_warp(*shape) for shape in [(2, 3, 4, 7), (1, 1, 1, 1), (2, 1, 3, 2), (1, 4, 3, 37), (1, 17, 2, 70)]],
    *[_warp(*shape) for shape in [(1, 3, 1, 130), (0, 2, 3, 4), (1, 0, 2, 3), (2, 1, 0, 3), (1, 2, 3, 0)]],
    *[_soft_argmin(*shape) for shape in [(2, 3, 4, 7, 0), (1, 1, 1, 1, -4), (1, 12, 3, 37, -2), (2, 5, 1, 70, 100)]],
    *[_soft_argmin(*shape) for shape in [(1, 192, 2, 19, 0), (0, 3, 4, 5, 0), (1, 3, 0, 5, 0), (1, 3, 5, 0, 1)]],
    *_spatial_propagation(2, 3, 4, 7),
    *_spatial_propagation(1, 1, 1, 1),
    *_spatial_propagation(1, 2, 1, 5),
    *_spatial_propagation(1, 2, 5, 1),
    *_spatial_propagation(1, 1, 2, 2),
    *_spatial_propagation(1, 2, 19, 37),
    *_spatial_propagation(1, 1, 35, 16),
    *_spatial_propagation(0, 2, 3, 4),
    *_spatial_propagation(1, 0, 3, 4),
    *_spatial_propagation(1, 2, 0, 4),
    *_spatial_propagation(1, 2, 3, 0),
]


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
