"""Calibration of a rectified pair: from disparity in pixels to depth in meters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError

if TYPE_CHECKING:
    from anynet.camera.rig import StereoRig

# Beyond these nothing is a camera; what is merely unusual is told by `anynet.camera.plausibility`.
_FARTHEST = 0.999e6  # meters: `read_depth` takes no more than a million
_LIMITS = {"focal": 1e6, "baseline": 1e4, "cx": 1e6, "cy": 1e6, "doffs": 1e6}


@dataclass(frozen=True)
class Calibration:
    """A rectified pair of cameras with square pixels.

    Attributes:
        focal: focal length, pixels.
        baseline: distance of the two cameras, meters.
        cx, cy: principal point of the left camera, pixels; None: the image's center.
        doffs: cx of the right camera minus cx of the left, pixels.
        size: width and height of the images it is for, if known.
        ndisp: upper bound of the scene's disparities, pixels, if the file tells it.
        origin: where the values come from, for reports.
        rig: the raw cameras behind it, if the file describes them too.
    """

    focal: float
    baseline: float
    cx: float | None = None
    cy: float | None = None
    doffs: float = 0.0
    size: tuple[int, int] | None = None
    ndisp: int | None = field(default=None, compare=False)
    origin: str = field(default="", compare=False)
    rig: StereoRig | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        for name in _LIMITS:
            if getattr(self, name) is not None:  # NumPy's numbers would not go into JSON
                object.__setattr__(self, name, float(getattr(self, name)))
        for name in ("focal", "baseline"):
            if not 0 < getattr(self, name) < math.inf:
                raise AnyNetError(f"calibration: expected {name} > 0, got {getattr(self, name):g}")
        for name in ("cx", "cy", "doffs"):
            if getattr(self, name) is not None and not math.isfinite(getattr(self, name)):
                raise AnyNetError(f"calibration: expected a finite {name}, got {getattr(self, name):g}")
        for name, limit in _LIMITS.items():
            if abs(getattr(self, name) or 0) > limit:
                unit = "meters (is the unit right?)" if name == "baseline" else "pixels"
                raise AnyNetError(f"calibration: expected {name} up to {limit:g} {unit}, got {getattr(self, name):g}")
        if self.size is not None:
            object.__setattr__(self, "size", checked_size(self.size))

    def values(self) -> dict[str, Any]:
        """focal, baseline, cx, cy, doffs and size, for JSON."""
        return {name: getattr(self, name) for name in ("focal", "baseline", "cx", "cy", "doffs", "size")}

    def depth(self, disparity: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Z = focal * baseline / (disparity + doffs): meters [H, W].

        NaN where unknown, not in front of the camera, or farther than 1000 km: no disparity is that exact.

        Args:
            disparity: float32 [H, W], or of single pixels, [N]; pixels, not finite where unknown.

        Raises:
            AnyNetError: if the calibration is known to be for maps of another size.
        """
        if disparity.ndim == 2:
            self.check_size(disparity.shape[1], disparity.shape[0])
        shifted = disparity + np.float32(self.doffs)
        known = (shifted > np.float32(self.focal * self.baseline / _FARTHEST)) & (shifted < np.inf)
        shifted[~known] = np.nan
        return np.float32(self.focal * self.baseline) / shifted

    def points(self, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """The point of every pixel, [H, W, 3] meters: x to the right, y down, z forward from the left camera.

        Raises:
            AnyNetError: if the calibration is known to be for maps of another size.
        """
        height, width = depth.shape
        self.check_size(width, height)
        cx = (width - 1) / 2 if self.cx is None else self.cx
        cy = (height - 1) / 2 if self.cy is None else self.cy
        x = (np.arange(width, dtype=np.float32) - np.float32(cx)) / np.float32(self.focal)
        y = (np.arange(height, dtype=np.float32)[:, None] - np.float32(cy)) / np.float32(self.focal)
        return np.stack([x * depth, y * depth, depth], axis=-1)

    def check_size(self, width: int, height: int) -> None:
        """Raises AnyNetError if the calibration is known to be for images of another size."""
        check_same_size(self.size, width, height)


def checked_size(size: Sequence[int]) -> tuple[int, int]:
    """A width and height of images, of any kind of sequence (JSON has lists).

    Raises:
        AnyNetError: if it is none.
    """
    width, height = map(int, size)
    if not all(1 <= side <= 1_000_000 for side in (width, height)):
        raise AnyNetError(f"calibration: expected an image size from 1 to 1000000, got {width} x {height}")
    return width, height


def check_same_size(size: tuple[int, int] | None, width: int, height: int) -> None:
    """Raises AnyNetError if `size`, that of a calibration, is known and not that of the images."""
    if size is not None and size != (width, height):
        expected = " x ".join(map(str, size))
        raise AnyNetError(f"expected images of {expected} as the calibration says, got {width} x {height}")
