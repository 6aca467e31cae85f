"""What every data set hands out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class StereoSample:
    """A rectified pair with the disparity of its left view.

    left, right: uint8 [H, W, 3], RGB. Left pixel (y, x) shows what right pixel (y, x - disparity) shows.
    disparity: float32 [H, W], pixels; NaN where unknown, unless `valid` says otherwise no value is to be used.
    valid: bool [H, W], where the disparity is known.
    noc: bool [H, W], where it is known and the right camera sees the point; None if the data do not say.
    foreground: bool [H, W], objects as against background; None if the data do not say.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    disparity: NDArray[np.float32]
    valid: NDArray[np.bool_]
    noc: NDArray[np.bool_] | None = None
    foreground: NDArray[np.bool_] | None = None
    name: str = ""
