"""Two raw cameras: how each sees, where they stand, and the rectification of their images. OpenCV does the mathematics.

Sources: Hartley and Zisserman, Multiple View Geometry, ch. 6 and 11; OpenCV's documentation of `stereoRectify`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from anynet.camera.calibration import Calibration, check_same_size, checked_size
from anynet.errors import AnyNetError

Matrix = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Maps = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]

PINHOLE, FISHEYE = "pinhole", "fisheye"
# OpenCV's: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]] (8 and more: rational); fisheye: k1 k2 k3 k4
_COEFFICIENTS = {PINHOLE: (4, 5, 8, 12, 14), FISHEYE: (4,)}
_ALIGNED = 5e-4  # radians: below half a pixel of rows at a focal length of 1000 pixels
_TURNED = 0.25  # pixels of disparity by which a turn about the vertical may be wrong
_SKEW = 5e-4  # of the focal length; OpenCV's rectification knows no skew


@dataclass(frozen=True, eq=False)
class Camera:
    """One raw camera.

    Attributes:
        matrix: [3, 3], focal lengths and principal point, pixels.
        distortion: OpenCV's coefficients: none, or 4, 5, 8 (rational), 12 or 14 of a pinhole, 4 of a fisheye camera.
        model: "pinhole" or "fisheye" (the equidistant model of Kannala and Brandt).
    """

    matrix: Matrix
    distortion: Matrix
    model: str = PINHOLE

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, np.float64)
        distortion = np.asarray(self.distortion, np.float64).reshape(-1)
        if self.model not in _COEFFICIENTS:
            raise AnyNetError(f"expected a camera model of pinhole or fisheye, got {self.model}")
        if matrix.shape != (3, 3) or not (np.isfinite(matrix).all() and 0 < matrix[0, 0] < 1e6 and matrix[1, 1] > 0):
            raise AnyNetError("expected a camera matrix of 3 x 3 with focal lengths > 0")
        if abs(matrix[1, 0]) + abs(matrix[2, 0]) + abs(matrix[2, 1]) > 1e-9 or abs(matrix[2, 2] - 1) > 1e-6:
            raise AnyNetError("expected a camera matrix whose rows end in 0 0 1 below the diagonal")
        counts = _COEFFICIENTS[self.model]
        if distortion.size and distortion.size not in counts:
            expected = ", ".join(map(str, counts))
            raise AnyNetError(f"expected {expected} distortion coefficients ({self.model}), got {distortion.size}")
        if not np.isfinite(distortion).all() or (np.abs(distortion) > 1e6).any():
            raise AnyNetError("expected finite distortion coefficients")
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion if distortion.size else np.zeros(counts[0]))

    @property
    def distorted(self) -> bool:
        """Whether straight lines look bent. A fisheye camera's always do."""
        return self.model == FISHEYE or bool((np.abs(self.distortion) > 1e-9).any())

    @property
    def skewed(self) -> bool:
        """Whether its pixels' axes are not square: by more than a fraction of a pixel at the image's border."""
        return abs(float(self.matrix[0, 1])) > _SKEW * float(self.matrix[1, 1])

    def check_skew(self) -> None:
        """Raises AnyNetError if the pixels' axes are not square: its images cannot be rectified."""
        if self.skewed:
            (fx, skew, _), (_, fy, _), _ = self.matrix
            raise AnyNetError(
                f"expected a camera matrix without skew, got {skew:g} beside focal lengths of {fx:g} and {fy:g}: "
                "calibrate with square axes (cv2.fisheye's CALIB_FIX_SKEW)"
            )


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two raw cameras, left first: a point X of the left camera's frame is rotation @ X + translation in the right's.

    Attributes:
        left, right: the cameras.
        rotation: [3, 3].
        translation: [3], meters; about (-baseline, 0, 0).
        size: width and height of the images it is for, if known.
        origin: where the values come from, for reports.
        rectified: of its rectified images, if the file describes them too; not what `rectify` makes.
    """

    left: Camera
    right: Camera
    rotation: Matrix
    translation: Matrix
    size: tuple[int, int] | None = None
    origin: str = ""
    rectified: Calibration | None = None

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, np.float64)
        translation = np.asarray(self.translation, np.float64).reshape(-1)
        if rotation.shape != (3, 3) or not np.isfinite(rotation).all():
            raise AnyNetError("expected a rotation of 3 x 3 between the cameras")
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 0.01 or np.linalg.det(rotation) < 0:
            raise AnyNetError("expected a rotation between the cameras, got a matrix that is none")
        if translation.shape != (3,) or not np.isfinite(translation).all() or np.abs(translation).max() > 1e6:
            raise AnyNetError("expected a translation of 3 finite numbers between the cameras")
        if self.size is not None:
            object.__setattr__(self, "size", checked_size(self.size))
        u, _, v = np.linalg.svd(rotation)  # files round their numbers
        object.__setattr__(self, "rotation", u @ v)
        object.__setattr__(self, "translation", translation)

    @property
    def baseline(self) -> float:
        """Meters between the cameras."""
        return float(np.linalg.norm(self.translation))

    @property
    def place(self) -> Matrix:
        """Where the right camera stands in the left one's frame, [3] meters: to the right, down, forward."""
        place: Matrix = -self.rotation.T @ self.translation
        return place

    @property
    def is_rectified(self) -> bool:
        """Whether its images already are a rectified pair, to half a pixel."""
        left, right = self.left.matrix, self.right.matrix
        yaw = (self.rotation[0, 2] - self.rotation[2, 0]) / 2 * left[0, 0]  # which depths, not rows, suffer from
        turned = math.sqrt(2) * math.sin(_ALIGNED / 2) * 2  # Frobenius norm of a rotation by that angle, minus 1
        return (
            not any(camera.distorted or camera.skewed for camera in (self.left, self.right))
            and float(np.linalg.norm(self.rotation - np.eye(3))) < turned
            and abs(yaw) < _TURNED
            and float(np.abs(self.translation[1:]).max()) <= _ALIGNED * self.baseline
            and abs(left[1, 2] - right[1, 2]) < 0.5
            and all(abs(focal - left[0, 0]) < 1e-3 * left[0, 0] for focal in (right[0, 0], left[1, 1], right[1, 1]))
        )

    def exchanged(self) -> StereoRig:
        """The same rig with the right camera first."""
        rotation = self.rotation.T
        return replace(
            self, left=self.right, right=self.left, rotation=rotation, translation=-rotation @ self.translation,
            rectified=None,
        )  # fmt: skip

    def with_baseline(self, baseline: float) -> StereoRig:
        """The same rig with the cameras that many meters apart."""
        if not 0 < baseline < math.inf:
            raise AnyNetError(f"calibration: expected baseline > 0, got {baseline:g}")
        if not self.baseline > 0:
            raise AnyNetError("expected two cameras apart, whose distance can be replaced, got a translation of 0")
        rectified = None if self.rectified is None else replace(self.rectified, baseline=baseline)
        return replace(self, translation=self.translation * (baseline / self.baseline), rectified=rectified)

    def with_rectified(self, rectified: Calibration) -> StereoRig:
        """The same rig with what a file says of its rectified images."""
        return replace(self, rectified=replace(rectified, rig=None))

    def rectify(self, alpha: float | None = None, size: tuple[int, int] | None = None) -> Rectification:
        """How to rectify this rig's images.

        Args:
            alpha: from 0, only what both cameras see, magnified, to 1, every pixel of theirs, with empty borders.
                None: the mean focal length, as OpenCV's `stereoRectify` does unless told otherwise.
            size: width and height of the images, where the rig does not know it; the rectified ones have the same.

        Raises:
            AnyNetError: if the size is not known or another one, or the cameras have skew or do not stand side by side.
        """
        if alpha is not None and not 0 <= alpha <= 1:
            raise AnyNetError(f"expected alpha from 0 to 1, got {alpha:g}")
        if size is not None:
            check_same_size(self.size, *size)
        size = size or self.size
        if size is None:
            raise AnyNetError("the calibration lacks the size of its images")
        if self.left.model != self.right.model:
            raise AnyNetError(f"expected two cameras of one model, got {self.left.model} and {self.right.model}")
        self.check_skew()
        self.check_side_by_side()
        fisheye = self.left.model == FISHEYE
        arguments = (
            self.left.matrix, self.left.distortion, self.right.matrix, self.right.distortion, size, self.rotation,
            self.translation.reshape(3, 1),
        )  # fmt: skip
        try:
            if fisheye:
                r1, r2, p1, p2, *_ = cv2.fisheye.stereoRectify(
                    *arguments, flags=cv2.CALIB_ZERO_DISPARITY, newImageSize=size, balance=alpha or 0.0
                )
            else:
                r1, r2, p1, p2, *_ = cv2.stereoRectify(
                    *arguments, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1 if alpha is None else alpha
                )
            r1, r2, p1, p2 = (np.asarray(matrix, np.float64) for matrix in (r1, r2, p1, p2))
            maps = _maps(self.left, r1, p1, size), _maps(self.right, r2, p2, size)
        except cv2.error as error:
            raise AnyNetError("the cameras cannot be rectified: OpenCV finds no solution for these values") from error
        calibration = Calibration(
            focal=float(p1[0, 0]), baseline=float(-p2[0, 3] / p2[0, 0]), cx=float(p1[0, 2]), cy=float(p1[1, 2]),
            doffs=float(p2[0, 2] - p1[0, 2]), size=size, origin=f"{self.origin or 'raw cameras'}, rectified", rig=self,
        )  # fmt: skip
        return Rectification(calibration, maps, _inside(maps[0], size), (r1, r2), (p1, p2))

    def check_skew(self) -> None:
        """Raises AnyNetError if a camera's pixels have no square axes."""
        self.left.check_skew()
        self.right.check_skew()

    def check_side_by_side(self) -> None:
        """Raises AnyNetError unless the second camera stands to the right of the first."""
        right, down, forward = (float(value) for value in self.place)
        if not self.baseline > 0:
            raise AnyNetError("expected two cameras apart, got a translation of 0")
        if abs(down) > max(abs(right), abs(forward)):
            raise AnyNetError(vertical(down))
        if abs(forward) > abs(right):
            raise AnyNetError("expected cameras side by side, got one behind the other (translation along z)")
        if right < 0:
            raise AnyNetError("expected the left camera first, got the right one: exchange the cameras")


@dataclass(frozen=True, eq=False)
class Rectification:
    """From raw to rectified images.

    Attributes:
        calibration: of the rectified pair.
        maps: for the left and the right image, the column and row of the raw image that each rectified pixel shows,
            two float32 [H, W] each, as `cv2.remap` takes them.
        valid: bool [H, W], the pixels of the rectified left view that the left camera saw.
        rotations, projections: R1, R2 [3, 3] and P1, P2 [3, 4] of OpenCV's `stereoRectify`.
    """

    calibration: Calibration
    maps: tuple[Maps, Maps]
    valid: npt.NDArray[np.bool_]
    rotations: tuple[Matrix, Matrix]
    projections: tuple[Matrix, Matrix]

    def __call__(self, left: Image, right: Image) -> tuple[Image, Image]:
        """The rectified images; black where a camera saw nothing.

        Args:
            left, right: raw images, uint8 [H, W, 3] (or [H, W]).

        Raises:
            AnyNetError: if their size is not the calibration's.
        """
        rectified = []
        for image, maps in zip((left, right), self.maps, strict=True):
            self.calibration.check_size(image.shape[1], image.shape[0])
            rectified.append(np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8))
        return rectified[0], rectified[1]


def vertical(down: float) -> str:
    """What is said of cameras one above the other; `down` is where the second stands from the first."""
    turn = "clockwise" if down < 0 else "counterclockwise"
    return (
        "expected cameras side by side, got one above the other (the baseline is vertical): "
        f"turn the images of both by 90 degrees {turn} and calibrate those"
    )


def _maps(camera: Camera, rotation: Matrix, projection: Matrix, size: tuple[int, int]) -> Maps:
    fisheye = camera.model == FISHEYE
    initialize = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    x, y = initialize(camera.matrix, camera.distortion, rotation, projection[:, :3], size, cv2.CV_32FC1)
    turning = math.inf if fisheye else _turning_point(camera.distortion)
    if turning < math.inf:  # what lies beyond would show a second time what lies before
        columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
        pixels = np.stack([columns, rows, np.ones_like(rows)], -1)
        rays = pixels @ np.linalg.inv(projection[:, :3] @ rotation).T
        beyond = (rays[..., 2] <= 0) | (np.hypot(rays[..., 0], rays[..., 1]) > turning * rays[..., 2])
        x[beyond] = y[beyond] = -2
    return np.asarray(x, np.float32), np.asarray(y, np.float32)


def _turning_point(distortion: Matrix) -> float:
    """Distance from the axis, in focal lengths, beyond which a pinhole camera's distortion leads back to it."""
    k = np.zeros(8)
    k[: min(8, distortion.size)] = distortion[:8]
    r = np.linspace(0, 10, 20001)
    distorted = r * (1 + k[0] * r**2 + k[1] * r**4 + k[4] * r**6) / (1 + k[5] * r**2 + k[6] * r**4 + k[7] * r**6)
    turning = np.flatnonzero(np.diff(distorted) <= 0)
    return float(r[turning[0]]) if turning.size else math.inf


def _inside(maps: Maps, size: tuple[int, int]) -> npt.NDArray[np.bool_]:
    x, y = maps
    return np.asarray((x >= 0) & (x <= size[0] - 1) & (y >= 0) & (y <= size[1] - 1))
