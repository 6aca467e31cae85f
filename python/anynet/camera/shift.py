"""Disparities that begin elsewhere than at 0: toed-in cameras and cut images have negative ones.

The network looks for disparities from 0 on. A pair moved apart by some columns has all its disparities larger by as
many; so it is moved, predicted, and the columns are subtracted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anynet.camera.calibration import Calibration
from anynet.camera.check import negative_disparities
from anynet.camera.matches import FEWEST, Matches
from anynet.errors import AnyNetError
from anynet.io.images import check_pair

if TYPE_CHECKING:
    from anynet import AnyNetConfig, Estimate, Predictor
    from anynet.frame import Image

_MARGIN = 16  # columns more than the matched corners need: they are few
_FEW, _FEW_OF = 3, 0.01  # corners that are more than chance
_LARGEST = 100_000


class ShiftedPredictor:
    """A predictor of disparities from `min_disparity` on, with the methods `stages` and `predict`, for the left view.

    Where the disparity cannot be known, at the left border if `min_disparity` is positive, it is NaN.

    Args:
        predictor: that of the pair moved by as much.
        min_disparity: the smallest disparity that is looked for, pixels; negative for toed-in cameras.

    Raises:
        AnyNetError: if `min_disparity` is not that.
    """

    def __init__(self, predictor: Predictor, min_disparity: int) -> None:
        number = isinstance(min_disparity, Integral) and not isinstance(min_disparity, bool)
        if not number or abs(min_disparity) > _LARGEST:
            raise AnyNetError(
                f"expected min_disparity as an integer from {-_LARGEST} to {_LARGEST} pixels, got {min_disparity!r}"
            )
        self.predictor = predictor
        self.min_disparity = int(min_disparity)

    @property
    def config(self) -> AnyNetConfig:
        """The predictor's."""
        return self.predictor.config

    def stages(
        self, left: Image, right: Image, *, confidence: bool = False, left_right: bool = False
    ) -> Iterator[Estimate]:
        """As `Predictor.stages`."""
        moved = moved_apart(left, right, self.min_disparity)
        for estimate in self.predictor.stages(*moved, confidence=confidence, left_right=left_right):
            yield moved_back(estimate, self.min_disparity, left)

    def predict(
        self,
        left: Image,
        right: Image,
        budget_ms: float | None = None,
        stage: int | None = None,
        *,
        confidence: bool = False,
        left_right: bool = False,
    ) -> Estimate:
        """As `Predictor.predict`."""
        moved = moved_apart(left, right, self.min_disparity)
        estimate = self.predictor.predict(*moved, budget_ms, stage, confidence=confidence, left_right=left_right)
        return moved_back(estimate, self.min_disparity, left)


def moved_apart(left: Image, right: Image, columns: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """The pair [H, W, 3] with disparities that many pixels smaller; below 0, larger.

    Raises:
        AnyNetError: if nothing would be left, or the images are not uint8 RGB arrays of one size.
    """
    check_pair(left, right)
    assert isinstance(left, np.ndarray)
    assert isinstance(right, np.ndarray)
    if columns < 0:  # more columns at the left image's left, and at the right image's right
        extra = ((0, 0), (-columns, 0), (0, 0)), ((0, 0), (0, -columns), (0, 0))
        return np.pad(left, extra[0], "edge"), np.pad(right, extra[1], "edge")
    if columns >= left.shape[1]:
        raise AnyNetError(f"expected min_disparity below the width of {left.shape[1]} pixels, got {columns}")
    return left[:, columns:], right[:, : right.shape[1] - columns]


def moved_back(estimate: Estimate, columns: int, left: Image) -> Estimate:
    """What an estimate on the pair moved apart says of the pair, whose left image is given."""
    seen, inner = (slice(max(0, columns), None), slice(max(0, -columns), None))

    def whole(values: npt.NDArray[Any], unknown: object) -> npt.NDArray[Any]:
        out = np.full(left.shape[:2], unknown, values.dtype)
        out[:, seen] = values[:, inner]
        return out

    disparity = whole(estimate.disparity + np.float32(columns), np.nan)
    if estimate.confidence is None or estimate.occluded is None:
        return replace(estimate, disparity=disparity)
    confidence, occluded = whole(estimate.confidence, 0), whole(estimate.occluded, True)
    return replace(estimate, disparity=disparity, confidence=confidence, occluded=occluded)


def min_disparity(calibration: Calibration | None, matches: Matches) -> int:
    """The smallest disparity to look for: below 0 where matched corners have such, as far as doffs allows, else 0.

    Points in front of the cameras have disparities above -doffs. Wrong matches seldom lie between that and 0, and walls
    and skies have no corners: a few there are enough.
    """
    allowed = 0.0 if calibration is None else calibration.doffs
    disparities = np.sort(matches.disparities)
    needed = negative_disparities(matches)
    between = disparities[(disparities >= -allowed - 1) & (disparities < -1)]
    if len(disparities) >= FEWEST and len(between) >= max(_FEW, _FEW_OF * len(disparities)):
        needed = max(needed, -float(between[1]))
    if allowed <= 0 or needed <= 0:
        return 0
    return -math.ceil(min(allowed, needed + _MARGIN))
