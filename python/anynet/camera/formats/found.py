"""What a reader of one format is asked, and what it found."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anynet.camera.rig import PINHOLE, Camera, StereoRig, vertical
from anynet.errors import AnyNetError

Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Request:
    """What the caller knows beside the files.

    Attributes:
        meters: meters per unit of the files' lengths, if the caller says it.
        size: width and height of the images, if known.
        images: the left image, if known: its folder's name may tell which cameras it is from.
        pair: "gray" or "color", which cameras of a file that has four.
    """

    meters: float | None = None
    size: tuple[int, int] | None = None
    images: Path | None = None
    pair: str | None = None


@dataclass
class Found:
    """What the files say.

    Attributes:
        origin: the format, and which of several cameras or resolutions was taken.
        values: focal, baseline, cx, cy, doffs of a rectified pair, as far as told; baseline in meters.
        lacking: for values that are not told, the fields that would tell them.
        size, ndisp: as in `Calibration`.
        rig: the raw cameras.
        raw: whether images that come with such files are raw ones, though rectified values are told too.
        warnings: what looks wrong, a sentence each.
    """

    origin: str
    values: dict[str, float] = field(default_factory=dict)
    lacking: dict[str, str] = field(default_factory=dict)
    size: tuple[int, int] | None = None
    ndisp: int | None = None
    rig: StereoRig | None = None
    raw: bool = False
    warnings: list[str] = field(default_factory=list)


EXCHANGED = (
    "camera 1 of the calibration is the right one: read with the cameras exchanged, "
    "so that LEFT has to be the left camera's image"
)


def camera_values(matrix: Matrix, which: str = "the camera") -> dict[str, float]:
    """focal, cx and cy of a rectified camera's matrix ([3, 3] or [3, 4]).

    Raises:
        AnyNetError: if its pixels are not square.
    """
    if abs(matrix[0, 0] - matrix[1, 1]) > 0.01 * abs(matrix[0, 0]):
        raise AnyNetError(f"expected square pixels of {which}, got focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g}")
    if not matrix[0, 0] > 0:
        raise AnyNetError(f"expected focal > 0, got {matrix[0, 0]:g}")
    return {"focal": float(matrix[0, 0]), "cx": float(matrix[0, 2]), "cy": float(matrix[1, 2])}


def from_values(found: Found, left: dict[str, float], right: dict[str, float]) -> None:
    """Enters the `camera_values` of two rectified cameras.

    Raises:
        AnyNetError: if their focal lengths differ.
    """
    if abs(left["focal"] - right["focal"]) > 0.01 * left["focal"]:
        raise AnyNetError(
            f"expected one focal length of both rectified cameras, got {left['focal']:g} and {right['focal']:g}"
        )
    found.values = {**left, "doffs": right["cx"] - left["cx"]}
    if abs(left["cy"] - right["cy"]) > 1:
        found.warnings.append(
            f"the two cameras' rows do not agree: cy is {left['cy']:g} and {right['cy']:g}; "
            "is the calibration of rectified images?"
        )


def one_size(left: tuple[int, int] | None, right: tuple[int, int] | None) -> tuple[int, int] | None:
    """The width and height that two cameras' images have, as far as told.

    Raises:
        AnyNetError: if they differ.
    """
    if None not in (left, right) and left != right:
        raise AnyNetError(f"expected one width and height of both cameras, got {left} and {right}")
    return left or right


def from_projections(found: Found, left: Matrix, right: Matrix, meters: float, lacking: str) -> None:
    """Enters the values of two projection matrices [3, 4], of which P[0, 3] = -focal * place on the baseline.

    Args:
        found: to enter them in.
        left, right: of camera 1 and 2, lengths in the file's unit.
        meters: meters per that unit.
        lacking: the field that tells the baseline, should it be 0.

    Raises:
        AnyNetError: if the cameras are no rectified pair side by side.
    """
    left, right = (_normalized(matrix) for matrix in (left, right))
    values = [camera_values(matrix, f"camera {i}") for i, matrix in enumerate((left, right), 1)]
    along, down = ((left[row, 3] - right[row, 3]) / left[0, 0] * meters for row in (0, 1))
    if abs(down) > abs(along):
        raise AnyNetError(vertical(down))
    forward = (left[2, 3] - right[2, 3]) * meters
    if abs(forward) > 0.01 * abs(along):
        raise AnyNetError(
            "expected projection matrices of a rectified pair, whose cameras stand side by side, "
            f"got one {abs(forward):g} m behind the other"
        )
    if along < 0:
        values.reverse()
        found.warnings.append(EXCHANGED)
    from_values(found, *values)
    if along:
        found.values["baseline"] = abs(along)
    else:
        found.lacking["baseline"] = lacking


def _normalized(projection: Matrix) -> Matrix:
    """So that its third row begins with 0 0 1: it is only told up to a factor."""
    if not np.isfinite(projection).all():
        raise AnyNetError("expected projection matrices of finite numbers")
    third = projection[2, :3]
    if not (third[2] and np.abs(third[:2]).max() < 1e-6 * abs(third[2])):
        raise AnyNetError(
            "expected projection matrices of rectified cameras, whose last row begins with 0 0 1, "
            f"got {' '.join(f'{value:g}' for value in third)}"
        )
    normalized: Matrix = projection / third[2]
    return normalized


def from_rig(found: Found, rig: StereoRig, lacking: str = "T") -> None:
    """Enters a rig: as the values of a rectified pair if it is one, else as a raw rig, left camera first."""
    if rig.baseline > 0 and rig.place[0] < 0 and abs(rig.place[0]) >= np.abs(rig.place[1:]).max():
        rig = rig.exchanged()
        found.warnings.append(EXCHANGED)
    found.size = found.size or rig.size
    if rig.is_rectified:
        left, right = (np.hstack([camera.matrix, np.zeros((3, 1))]) for camera in (rig.left, rig.right))
        right[0, 3] = right[0, 0] * rig.translation[0]
        from_projections(found, left, right, 1.0, lacking)
    else:
        if rig.baseline > 0:
            rig.check_side_by_side()
        found.rig = rig


def pinhole(fx: float, fy: float, cx: float, cy: float, distortion: object = (), model: str = PINHOLE) -> Camera:
    """A camera by its four intrinsic numbers, pixels, and OpenCV's distortion coefficients."""
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    return Camera(matrix, np.asarray(distortion, np.float64), model)
