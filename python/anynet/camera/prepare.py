"""From two images and what is known of the cameras to a pair that a predictor takes, and back to what it found."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anynet.camera.calibration import Calibration
from anynet.camera.check import check_rectified
from anynet.camera.matches import match_corners
from anynet.camera.plausibility import MAX_DISPARITY, check_calibration, check_principal_point
from anynet.camera.rig import Rectification, StereoRig
from anynet.camera.rows import RowShift, fit_rows
from anynet.camera.shift import ShiftedPredictor, min_disparity
from anynet.errors import AnyNetError
from anynet.io.images import check_pair

if TYPE_CHECKING:
    from anynet import Predictor

Image = npt.NDArray[np.uint8]
Map = npt.NDArray[np.float32]

_LEAST_SHIFT, _LEAST_ROLL = 0.05, 5e-5  # pixels, radians: less is not worth blurring the image


@dataclass(frozen=True, eq=False)
class PreparedPair:
    """A rectified pair, left image first.

    Attributes:
        left, right: uint8 [H, W, 3] RGB.
        calibration: of these images, if known.
        min_disparity: the smallest disparity to look for, pixels.
        valid: bool [H, W], the pixels of the left image that the camera saw; None: all.
        warnings: what looks wrong, a sentence each.
        notes: what was done to the images, a sentence each.
    """

    left: Image
    right: Image
    calibration: Calibration | None
    min_disparity: int = 0
    valid: npt.NDArray[np.bool_] | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def predictor(self, predictor: Predictor) -> Predictor | ShiftedPredictor:
        """The predictor for this pair: the one given, or that one on images moved apart."""
        return ShiftedPredictor(predictor, self.min_disparity) if self.min_disparity else predictor

    def known(self, disparity: Map) -> Map:
        """The disparity [H, W] with NaN wherever it is not known: outside of what the camera saw, or behind it.

        That is, too, where it is not above the smallest one looked for: the network's refinement went astray there.
        """
        known = np.where(disparity > np.float32(self.min_disparity), disparity, np.float32(np.nan))
        if self.calibration is not None:
            known[np.isnan(self.calibration.depth(known))] = np.nan
        if self.valid is not None:
            known[~self.valid] = np.nan
        return known


class PairPreparation:
    """Rectifies, checks and corrects the pairs of one pair of cameras.

    Args:
        cameras: what `read_calibration` gave: of rectified images, or of raw ones, which are then rectified; or None.
        raw: True: the images are raw; False: they are rectified, as `cameras.rectified` says unless `alpha` is given;
            None: as `cameras` says.
        alpha: see `StereoRig.rectify`.
        check: match corners, and warn if a pair looks unrectified, swapped or too near.
        fix_rows: remove a small vertical shift and roll, found by matched corners.
        min_disparity: the smallest disparity to look for, pixels; None: below 0 where matched corners and doffs say so.
        reach: the largest disparity that the network finds, pixels (see `anynet.camera.plausibility.reach_of`).

    Raises:
        AnyNetError: if the images are said to be raw, or `alpha` is given, but nothing is known of raw cameras.
    """

    def __init__(
        self,
        cameras: Calibration | StereoRig | None = None,
        *,
        raw: bool | None = None,
        alpha: float | None = None,
        check: bool = True,
        fix_rows: bool = False,
        min_disparity: int | None = None,
        reach: float = MAX_DISPARITY,
    ) -> None:
        if not isinstance(cameras, Calibration | StereoRig | None):
            raise AnyNetError(f"expected cameras as read_calibration gives them, got {type(cameras).__name__}")
        rig = cameras.rig if isinstance(cameras, Calibration) else cameras
        origin = f" ({cameras.origin})" if isinstance(cameras, Calibration) and cameras.origin else ""
        if raw and rig is None:
            raise AnyNetError(f"expected a calibration of raw cameras to rectify with (--raw), got none{origin}")
        self._cameras = rig if raw else cameras
        if alpha is not None and not isinstance(self._cameras, StereoRig):
            hint = "" if rig is None else "; it describes the raw cameras too: if the images are raw, use --raw"
            raise AnyNetError(f"alpha (--alpha) belongs to a calibration of raw cameras, got none{origin}{hint}")
        if raw is False and isinstance(cameras, StereoRig) and cameras.rectified is not None and alpha is None:
            self._cameras = cameras.rectified
        self._raw = isinstance(self._cameras, StereoRig) and raw is not False
        self._alpha = alpha
        self._check = check
        self._fix_rows = fix_rows
        self._min_disparity = min_disparity
        self._reach = reach
        self._rectifications: dict[tuple[int, int], Rectification] = {}

    def __call__(self, left: Image, right: Image) -> PreparedPair:
        """The pair rectified.

        Args:
            left, right: uint8 [H, W, 3] RGB of one size.

        Raises:
            AnyNetError: if the images are not that, the calibration is for images of another size, or the cameras
                cannot be rectified.
        """
        check_pair(left, right)
        height, width = left.shape[:2]
        calibration, valid, notes, findings = self._calibration(width, height)
        if self._raw:
            left, right = self._rectified(width, height)(left, right)
        smallest = self._min_disparity or 0
        if calibration is not None:
            calibration.check_size(width, height)
            findings += check_calibration(calibration, width, height, self._reach, smallest)
        doffs = 0.0 if calibration is None else calibration.doffs
        searched = self._min_disparity is None and doffs > 0
        if self._check or self._fix_rows or searched:
            matches = match_corners(left, right)
            shift = fit_rows(matches) if self._fix_rows else None
            if shift is not None and (abs(shift.shift) > _LEAST_SHIFT or abs(shift.roll) > _LEAST_ROLL):
                right = shift.corrected(right)
                matches = match_corners(left, right)
                notes.append(f"the right image was {_told(shift)}: corrected")
            elif self._fix_rows and shift is None:
                findings.append("rows not corrected: too few corners match, or the error is no small shift and roll")
            if searched:
                smallest = min_disparity(calibration, matches)
            if self._check:
                findings += check_rectified(left, right, matches, doffs, self._reach, self._hint(), smallest)
        if smallest:
            notes.append(f"disparities looked for from {smallest} pixels on")
        return PreparedPair(left, right, calibration, smallest, valid, tuple(findings), tuple(notes))

    def following(self, first: PreparedPair) -> PairPreparation:
        """For the frames after the first of a stream: without its checks, and with what it found."""
        following = copy.copy(self)
        following._check, following._min_disparity = False, first.min_disparity
        return following

    def _hint(self) -> str:
        """What may be the reason for rows that do not agree."""
        if self._raw:
            return "; is the calibration of this rig, and were the images raw? (--rectified if not)"
        if isinstance(self._cameras, Calibration) and self._cameras.rig is not None:
            return "; the calibration describes the raw cameras too: if the images are raw, use --raw"
        return ""

    def _calibration(
        self, width: int, height: int
    ) -> tuple[Calibration | None, npt.NDArray[np.bool_] | None, list[str], list[str]]:
        """Of the rectified images, where they are valid, and what is to be said."""
        if not isinstance(self._cameras, StereoRig):
            return self._cameras, None, [], []
        rectification = self._rectified(width, height)
        if not self._raw:
            return replace(rectification.calibration, rig=None), None, [], []
        matrix = self._cameras.left.matrix
        findings = check_principal_point(float(matrix[0, 2]), float(matrix[1, 2]), width, height)
        return rectification.calibration, rectification.valid, ["rectified by the calibration of raw cameras"], findings

    def _rectified(self, width: int, height: int) -> Rectification:
        size = width, height
        if size not in self._rectifications:
            assert isinstance(self._cameras, StereoRig)
            self._rectifications.clear()  # one size at a time: its maps are large
            self._rectifications[size] = self._cameras.rectify(self._alpha, size)
        return self._rectifications[size]


def _told(shift: RowShift) -> str:
    roll = math.degrees(shift.roll)
    return (
        f"{abs(shift.shift):.2f} rows {'lower' if shift.shift > 0 else 'higher'} and turned {abs(roll):.3f} degrees "
        f"{'clockwise' if roll > 0 else 'counterclockwise'}"
    )
