"""Cameras: calibrations from any tool's files, rectification, and what goes wrong with both."""

from typing import TYPE_CHECKING, Any

from anynet.camera.calibration import Calibration
from anynet.camera.check import check_rectified
from anynet.camera.matches import Matches, match_corners
from anynet.camera.plausibility import check_calibration
from anynet.camera.prepare import PairPreparation, PreparedPair
from anynet.camera.rig import Camera, Rectification, StereoRig
from anynet.camera.rows import RowShift, RowWatch, fit_rows
from anynet.camera.shift import ShiftedPredictor, min_disparity

if TYPE_CHECKING:
    from anynet.camera.read import read_calibration

__all__ = [
    "Calibration",
    "Camera",
    "Matches",
    "PairPreparation",
    "PreparedPair",
    "Rectification",
    "RowShift",
    "RowWatch",
    "ShiftedPredictor",
    "StereoRig",
    "check_calibration",
    "check_rectified",
    "fit_rows",
    "match_corners",
    "min_disparity",
    "read_calibration",
]


def __getattr__(name: str) -> Any:
    """Imports the parsers of files on first use: a pair without a calibration must not wait for them."""
    if name != "read_calibration":
        raise AttributeError(f"module 'anynet.camera' has no attribute {name!r}")
    from anynet.camera.read import read_calibration

    return read_calibration
