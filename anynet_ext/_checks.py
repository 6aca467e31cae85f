"""Argument checks shared by the operators' Python functions: what was expected and what came."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import SymBool, SymInt, Tensor

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


def matches(op: str, name: str, value: object, shape: Sequence[int | SymInt], first: Tensor) -> Tensor:
    """Checks that `value` is a tensor of this shape, with the dtype and device of the call's first tensor.

    Sizes that are not known while a graph is traced are left to the operator, which checks again when it runs.
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{op}: expected {name} to be a Tensor, got {type(value).__name__}")
    if value.dim() != len(shape) or any(surely(a != b) for a, b in zip(value.shape, shape, strict=True)):
        raise ValueError(f"{op}: expected {name} of shape {list(shape)}, got {list(value.shape)}")
    if computed_dtype(value) != computed_dtype(first):
        raise TypeError(f"{op}: expected all tensors of one dtype, got {first.dtype} and, for {name}, {value.dtype}")
    if value.device != first.device:
        raise ValueError(
            f"{op}: expected all tensors on one device, got {first.device} and, for {name}, {value.device}"
        )
    return value


def computed_dtype(value: Tensor) -> torch.dtype:
    """What the operator gets: autocast makes float32 of half types, and leaves all others alone."""
    half = value.dtype in (torch.float16, torch.bfloat16)
    # PyTorch raises if asked about autocast on the meta device.
    autocast = value.device.type in ("cpu", "cuda") and torch.is_autocast_enabled(value.device.type)
    return torch.float32 if half and autocast else value.dtype


def surely(condition: bool | SymBool) -> bool:
    """Whether a condition on sizes is known to hold: while a graph is traced, not all sizes need be known."""
    if isinstance(condition, bool) and not torch.compiler.is_compiling():
        return condition
    from torch.fx.experimental.symbolic_shapes import guard_or_false  # importing it takes longer than all of ours

    return guard_or_false(condition)


def integer(op: str, name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, SymInt)):
        raise TypeError(f"{op}: expected {name} to be an int, got {type(value).__name__}")
    return value  # type: ignore[return-value]
