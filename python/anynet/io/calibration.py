"""Calibration of a rectified pair: from disparity in pixels to depth in metres."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError
from anynet.io.files import read_bytes

Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Calibration:
    """A rectified pair of cameras with square pixels."""

    focal: float  # pixels
    baseline: float  # metres between the two cameras
    cx: float | None = None  # principal point of the left camera, pixels; None: the image's centre
    cy: float | None = None
    doffs: float = 0.0  # cx of the right camera minus cx of the left, pixels
    size: tuple[int, int] | None = None  # width and height of the images it is for, if known

    def __post_init__(self) -> None:
        for name in ("focal", "baseline"):
            if not 0 < getattr(self, name) < math.inf:
                raise AnyNetError(f"calibration: expected {name} > 0, got {getattr(self, name):g}")
        for name in ("cx", "cy", "doffs"):
            if getattr(self, name) is not None and not math.isfinite(getattr(self, name)):
                raise AnyNetError(f"calibration: expected a finite {name}, got {getattr(self, name):g}")

    def depth(self, disparity: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Z = focal * baseline / (disparity + doffs): metres [H, W], NaN where unknown or not in front of the camera.

        Args:
            disparity: float32 [H, W], pixels, NaN where unknown.
        """
        shifted = disparity + np.float32(self.doffs)
        shifted[~(shifted > 0)] = np.nan
        return np.float32(self.focal * self.baseline) / shifted

    def points(self, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """The point of every pixel, [H, W, 3] metres: x to the right, y down, z forward from the left camera."""
        height, width = depth.shape
        cx = (width - 1) / 2 if self.cx is None else self.cx
        cy = (height - 1) / 2 if self.cy is None else self.cy
        x = (np.arange(width, dtype=np.float32) - np.float32(cx)) / np.float32(self.focal)
        y = (np.arange(height, dtype=np.float32)[:, None] - np.float32(cy)) / np.float32(self.focal)
        return np.stack([x * depth, y * depth, depth], axis=-1)


def read_calibration(path: str | Path) -> Calibration:
    """Reads a calibration of KITTI, Middlebury or OpenCV, told apart by their content.

    * KITTI `calib_cam_to_cam.txt` (P_rect_02, P_rect_03) and object, odometry or 2012 files (P2, P3); the grey pair
      (0, 1) where the colour pair is missing. Metres.
    * Middlebury and ETH3D `calib.txt`: cam0, baseline (millimetres), doffs.
    * OpenCV YAML or XML: Q; or P1 and P2; or K (also K1 or M1, with K2 or M2) and T of an already rectified pair. Such
      files have no unit: they are taken as metres.

    Raises:
        AnyNetError: if the file is missing, of no such kind, or lacks a field.
    """
    text = read_bytes(path).decode("utf-8", errors="replace")
    try:
        if text.lstrip().startswith(("%YAML", "<?xml")):
            return _opencv(text)
        if re.search(r"^cam0\s*=", text, re.MULTILINE):
            return _middlebury(dict(re.findall(r"^(\w+)\s*=\s*(.*?)\s*$", text, re.MULTILINE)))
        if re.search(r"^P(_rect_0)?\d\s*:", text, re.MULTILINE):
            return _kitti(dict(re.findall(r"^(\w+)\s*:\s*(.*?)\s*$", text, re.MULTILINE)))
    except KeyError as error:
        raise AnyNetError(f"{path}: the calibration lacks {error.args[0]}") from error
    except AnyNetError as error:
        raise AnyNetError(f"{path}: {error}") from error
    raise AnyNetError(f"{path}: expected a calibration of KITTI, Middlebury or OpenCV, got something else")


def _kitti(fields: Mapping[str, str]) -> Calibration:
    name = "P_rect_0{}" if any(field.startswith("P_rect") for field in fields) else "P{}"
    first = 2 if name.format(2) in fields or name.format(3) in fields else 0
    left, right = (_numbers(name.format(camera), fields, 12).reshape(3, 4) for camera in (first, first + 1))
    size = _numbers(f"S_rect_0{first}", fields, 2) if f"S_rect_0{first}" in fields else None
    # P[0, 3] = -focal * x, the camera's place on the baseline
    baseline = (left[0, 3] - right[0, 3]) / left[0, 0]
    return _from_cameras(left, right, baseline, None if size is None else (int(size[0]), int(size[1])))


def _middlebury(fields: Mapping[str, str]) -> Calibration:
    camera = _numbers("cam0", fields, 9).reshape(3, 3)
    (baseline,), (doffs,) = _numbers("baseline", fields, 1), _numbers("doffs", fields, 1)
    _check_square(camera)
    size = None
    if "width" in fields and "height" in fields:
        size = int(_numbers("width", fields, 1)[0]), int(_numbers("height", fields, 1)[0])
    return Calibration(camera[0, 0], baseline / 1000, camera[0, 2], camera[1, 2], doffs, size)


def _opencv(text: str) -> Calibration:
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        names = storage.root().keys()
        matrices = {name: storage.getNode(name).mat() for name in names if storage.getNode(name).isMap()}
    except (cv2.error, SystemError) as error:
        raise AnyNetError("not readable by OpenCV's FileStorage") from error

    def matrix(name: str, *shape: int) -> Matrix:
        value = matrices[name]
        if value is None or value.size != math.prod(shape):
            raise AnyNetError(f"expected {name} to be a matrix of {' x '.join(map(str, shape))}")
        return np.asarray(value, dtype=np.float64).reshape(shape)

    if "Q" in matrices:  # cv2.stereoRectify: Z = Q[2,3] / (Q[3,2] d + Q[3,3])
        q = matrix("Q", 4, 4)
        if q[3, 2] == 0:
            raise AnyNetError("expected Q[3, 2] = -1 / Tx, got 0")
        return Calibration(q[2, 3], abs(1 / q[3, 2]), -q[0, 3], -q[1, 3], q[3, 3] / q[3, 2])
    if "P1" in matrices or "P2" in matrices:
        left, right = matrix("P1", 3, 4), matrix("P2", 3, 4)
        return _from_cameras(left, right, -right[0, 3] / right[0, 0])
    left_name = next((name for name in ("K", "K1", "M1") if name in matrices), None)
    if left_name is None:
        raise AnyNetError(f"the calibration lacks Q, P1 and P2, or K and T; it has {', '.join(names) or 'nothing'}")
    left = matrix(left_name, 3, 3)
    right_name = next((name for name in ("K2", "M2") if name in matrices), left_name)
    return _from_cameras(left, matrix(right_name, 3, 3), float(np.linalg.norm(matrix("T", 3))))


def _from_cameras(left: Matrix, right: Matrix, baseline: float, size: tuple[int, int] | None = None) -> Calibration:
    _check_square(left)
    return Calibration(
        focal=float(left[0, 0]),
        baseline=float(baseline),
        cx=float(left[0, 2]),
        cy=float(left[1, 2]),
        doffs=float(right[0, 2] - left[0, 2]),
        size=size,
    )


def _check_square(camera: Matrix) -> None:
    if abs(camera[0, 0] - camera[1, 1]) > 0.01 * abs(camera[0, 0]):
        raise AnyNetError(f"expected square pixels, got focal lengths {camera[0, 0]:g} and {camera[1, 1]:g}")


def _numbers(name: str, fields: Mapping[str, str], count: int) -> Matrix:
    """The numbers of a field, in whatever brackets and separators."""
    text = fields[name]
    try:
        values = [float(word) for word in re.split(r"[\s,;\[\]]+", text) if word]
    except ValueError as error:
        raise AnyNetError(f"expected {name} to be {count} numbers, got {text!r}") from error
    if len(values) != count:
        raise AnyNetError(f"expected {name} to be {count} numbers, got {len(values)}")
    return np.array(values)
