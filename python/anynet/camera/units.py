"""Units of length, by the names that options take."""

from __future__ import annotations

from anynet.errors import AnyNetError

METERS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}


def meters_per(unit: str) -> float:
    """How many meters the unit is.

    Raises:
        AnyNetError: if its name is not known.
    """
    if unit not in METERS:
        raise AnyNetError(f"expected a unit of {', '.join(METERS)}, got {unit!r}")
    return METERS[unit]
