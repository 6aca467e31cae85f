"""Argument checks shared by the operators' Python functions: TypeError and ValueError with what was expected and got."""

from __future__ import annotations

import torch
from torch import Tensor

DTYPES = (torch.float32, torch.float64, torch.float16, torch.bfloat16)


def tensor(op: str, name: str, value: object, layout: str) -> Tensor:
    """Checks that `value` is a floating tensor with as many dimensions as `layout` ("N, C, H, W") names."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{op}: expected {name} to be a Tensor, got {type(value).__name__}")
    if value.dtype not in DTYPES:
        raise TypeError(f"{op}: expected {name} of dtype float32, float64, float16 or bfloat16, got {value.dtype}")
    if value.dim() != layout.count(",") + 1:
        raise ValueError(f"{op}: expected {name} of shape [{layout}], got {list(value.shape)}")
    return value


def integer(op: str, name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, torch.SymInt)):
        raise TypeError(f"{op}: expected {name} to be an int, got {type(value).__name__}")
    return value  # type: ignore[return-value]
