"""Types and bounds of a configuration's values: a file may hold anything."""

from __future__ import annotations

from typing import Any

from anynet.errors import AnyNetError

INPUT_SCALES = 1 / 16, 4.0  # smallest and largest
FARTHEST = 1024  # disparity or residual to test, in pixels of its stage


def check_whole(part: object, name: str, low: int, high: int) -> None:
    value = getattr(part, name)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise AnyNetError(f"{type(part).__name__}: expected {name} as an integer from {low} to {high}, got {value!r}")


def check_flag(part: object, name: str) -> None:
    value = getattr(part, name)
    if not isinstance(value, bool):
        raise AnyNetError(f"{type(part).__name__}: expected {name} as true or false, got {value!r}")


def check_range(part: object, name: str, value: object) -> None:
    whole = isinstance(value, tuple) and len(value) == 2 and all(type(end) is int for end in value)
    if not (whole and -FARTHEST <= value[0] <= value[1] <= FARTHEST):  # type: ignore[index]
        raise AnyNetError(
            f"{type(part).__name__}: expected {name} as (first, last), integers with first <= last "
            f"from {-FARTHEST} to {FARTHEST}, got {value!r}"
        )


def check_input_scale(config: object, scale: object) -> None:
    low, high = INPUT_SCALES
    if isinstance(scale, bool) or not isinstance(scale, (int, float)) or not low <= scale <= high:
        raise AnyNetError(f"{type(config).__name__}: expected input_scale from {low:g} to {high:g}, got {scale!r}")


def as_tuples(value: Any) -> Any:
    """JSON has lists only; configurations hold tuples, perhaps of tuples."""
    return tuple(as_tuples(v) for v in value) if isinstance(value, list) else value
