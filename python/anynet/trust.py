"""What to keep of an estimate: what is likely right, what both cameras see, what is near enough to be told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError

if TYPE_CHECKING:
    from anynet.camera import Calibration
    from anynet.predictor import Estimate

Map = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

FARTHEST = 2.5  # pixels of disparity, at which half a pixel of error is 20 % of the depth
STEEPEST = 0.5, 1.0  # pixels of disparity per column and per row: steeper are no surfaces but edges, blurred


@dataclass(frozen=True)
class Trust:
    """What becomes unknown (NaN) in disparity maps.

    Args:
        min_confidence: what is less likely to be right, 0 to 1.
        drop_occluded: what the right camera does not see, and the ramps between a thing and what is behind it.

    Raises:
        AnyNetError: if an argument is not that.
    """

    min_confidence: float = 0.0
    drop_occluded: bool = False

    def __post_init__(self) -> None:
        least = self.min_confidence
        if isinstance(least, bool) or not isinstance(least, (int, float)) or not 0 <= least <= 1:
            raise AnyNetError(f"expected min_confidence from 0 to 1, got {least!r}")
        if not isinstance(self.drop_occluded, bool):
            raise AnyNetError(f"expected drop_occluded as True or False, got {self.drop_occluded!r}")

    @property
    def asked(self) -> bool:
        """Whether anything is dropped, so that estimates need their confidence."""
        return self.min_confidence > 0 or self.drop_occluded

    def kept(self, estimate: Estimate) -> Map:
        """The disparity [H, W] of an estimate with confidence, NaN where it is not to be trusted."""
        if not self.asked:
            return estimate.disparity
        if estimate.confidence is None or estimate.occluded is None:
            raise AnyNetError("expected an estimate with confidence (confidence=True)")
        dropped = estimate.confidence < self.min_confidence
        if self.drop_occluded:
            dropped |= estimate.occluded | steep(estimate.disparity)
        return np.where(dropped, np.float32(np.nan), estimate.disparity)


def steep(disparity: Map) -> Mask:
    """Where a disparity map [H, W] is steeper than surfaces are."""
    out = np.zeros(disparity.shape, bool)
    for axis, limit in ((1, STEEPEST[0]), (0, STEEPEST[1])):
        jump = np.abs(np.diff(disparity, axis=axis)) > limit
        out |= np.insert(jump, 0, False, axis=axis) | np.insert(jump, jump.shape[axis], False, axis=axis)
    return out


def within_reach(depth: Map, calibration: Calibration, max_depth: float | None) -> Mask:
    """Where a depth map [H, W] is known and not beyond `max_depth`, meters; None: what half a pixel tells to 20 %."""
    limit = calibration.focal * calibration.baseline / FARTHEST if max_depth is None else max_depth
    result: Mask = depth <= limit
    return result
