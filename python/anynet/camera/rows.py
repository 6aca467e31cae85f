"""Watching whether a rig's rows still agree, and putting a small error right: a vertical shift and a roll."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anynet.camera.calibration import Calibration
from anynet.camera.check import ROWS, lowest_disparity
from anynet.camera.matches import FEWEST, Matches, match_corners
from anynet.camera.shift import min_disparity

Image = npt.NDArray[np.uint8]

_ROUNDS, _FAR = 5, 3.0  # of the robust fit; matches farther off than that many deviations are left out
_LARGEST_SHIFT, _LARGEST_ROLL = 0.05, math.radians(5)  # of the height; beyond, it is no small error


@dataclass(frozen=True)
class RowShift:
    """How the right image's rows are off: right row = left row + shift + roll * (x - center).

    Attributes:
        shift: rows in the middle of the image, pixels.
        roll: of the right camera about its axis, radians; positive: its image is turned clockwise.
    """

    shift: float
    roll: float

    def corrected(self, right: Image) -> Image:
        """The right image [H, W, 3] with its rows moved to the left image's; its edge is repeated at the borders."""
        height, width = right.shape[:2]
        c, s = math.cos(self.roll), math.sin(self.roll)
        x, y = (width - 1) / 2, (height - 1) / 2
        # From the corrected image's pixels to the given one's.
        matrix = np.array([[c, -s, x - c * x + s * y], [s, c, y - s * x - c * y + self.shift]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        moved = cv2.warpAffine(right, matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(moved, np.uint8)


def fit_rows(matches: Matches) -> RowShift | None:
    """The shift and roll that explain most matches; None if there are too few, or the error is no small one."""
    if not matches.enough:
        return None
    width, height = matches.size
    x, y = matches.points[:, 0] - (width - 1) / 2, matches.offsets[:, 1]
    # Turning moves a right pixel by its own place, so the right x counts.
    x = x + matches.offsets[:, 0]
    kept = np.abs(y - np.median(y)) <= max(3.0, 3 * 1.4826 * float(np.median(np.abs(y - np.median(y)))))
    shift, roll = float(np.median(y)), 0.0
    for _ in range(_ROUNDS):
        if np.count_nonzero(kept) < FEWEST:
            return None
        design = np.stack([np.ones(np.count_nonzero(kept)), x[kept]], axis=1)
        shift, roll = (float(value) for value in np.linalg.lstsq(design, y[kept], rcond=None)[0])
        errors = np.abs(y - shift - roll * x)
        kept = errors <= max(0.5, _FAR * 1.4826 * float(np.median(errors)))
    if abs(shift) > _LARGEST_SHIFT * height or abs(roll) > _LARGEST_ROLL:
        return None
    return RowShift(shift, math.atan(roll))


class RowWatch:
    """Looks at one frame in many, and tells when a running rig's rows have drifted, or its disparities are below all
    that are looked for: what its first frame showed may not be what comes.

    Args:
        every: frames from one look to the next; a look takes some 10 ms at 640 x 480.
        looks: how many of the last looks are judged together.
        threshold: pixels that matched corners may lie apart (median).
    """

    def __init__(self, every: int = 30, looks: int = 5, threshold: float = ROWS) -> None:
        self.every = every
        self.threshold = threshold
        self._rows: deque[float] = deque(maxlen=looks)
        self._frames = 0
        self._told = self._told_below = False

    def __call__(
        self, left: Image, right: Image, calibration: Calibration | None = None, smallest: int = 0
    ) -> str | None:
        """A sentence when the rows have drifted, once until they are good again, or when disparities lie below the
        smallest, as far as doffs allows, once; else None.

        Args:
            left, right: the rectified pair, uint8 [H, W, 3] RGB.
            calibration: of these images, if known.
            smallest: the smallest disparity that is looked for, pixels.
        """
        self._frames += 1
        if (self._frames - 1) % self.every:
            return None
        matches = match_corners(left, right)
        if matches.enough:
            self._rows.append(matches.rows_apart)
        if not self._rows:
            return None
        apart = float(np.median(self._rows))
        if apart <= self.threshold:
            self._told = False
            return self._below(matches, calibration, smallest)
        if self._told:
            return None
        self._told = True
        return f"matched corners lie {apart:.1f} rows apart (median): the cameras have moved; calibrate, or --fix-rows"

    def _below(self, matches: Matches, calibration: Calibration | None, smallest: int) -> str | None:
        reached, needed = lowest_disparity(matches), min_disparity(calibration, matches)
        if self._told_below or max(reached, needed) >= smallest:
            return None
        self._told_below = True
        below = "" if calibration is None or reached >= needed else f" (doffs is {calibration.doffs:g}: no depth below)"
        return (
            f"matched corners have disparities down to {reached:.0f} pixels, which are looked for from {smallest} on: "
            f"use --min-disparity {needed}{below}"
        )
