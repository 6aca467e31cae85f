"""Calibrates two cameras by views of a board. OpenCV solves; views that do not fit are left out.

Source: Zhang, A flexible new technique for camera calibration, PAMI 2000, as in OpenCV's `stereoCalibrate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anynet.camera.boards import View
from anynet.camera.rig import FISHEYE, PINHOLE, Camera, Rectification, StereoRig
from anynet.errors import AnyNetError

MODELS = (PINHOLE, "rational", FISHEYE)
FEWEST_VIEWS = 5
_OUTLIER, _NEGLIGIBLE = 3.0, 0.3  # times the median error; and pixels that are never too much
_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-7)

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BoardCalibration:
    """What came out.

    Attributes:
        rig: the raw cameras.
        rectification: of their images.
        views: those used.
        left_out: names of those left out, and why.
        reprojection: root mean square distance of seen and calculated corners, of both cameras, pixels.
        vertical: the same of the rows of a corner in the two rectified images, pixels.
        vertical_largest: the largest such distance, pixels.
    """

    rig: StereoRig
    rectification: Rectification
    views: tuple[View, ...]
    left_out: tuple[tuple[str, str], ...]
    reprojection: float
    vertical: float
    vertical_largest: float


def calibrate(views: Sequence[View], size: tuple[int, int], model: str = PINHOLE) -> BoardCalibration:
    """Calibrates by the views of a board.

    Args:
        views: at least 5, better 20, with the board near and far, at the borders, and tilted.
        size: width and height of the images.
        model: of the distortion: "pinhole" (5 coefficients), "rational" (8) or "fisheye" (4).

    Raises:
        AnyNetError: if there are too few views that agree, or they do not determine the cameras.
    """
    if model not in MODELS:
        raise AnyNetError(f"expected a model of {', '.join(MODELS)}, got {model}")
    used = list(views)
    left_out: list[tuple[str, str]] = []
    while True:
        if len(used) < FEWEST_VIEWS:
            raise AnyNetError(
                f"expected at least {FEWEST_VIEWS} views of the board that agree, got {len(used)}"
                + "".join(f"; {name}: {why}" for name, why in left_out[:5])
            )
        rig, errors = _solve(used, size, model)
        bad = errors > max(_NEGLIGIBLE, _OUTLIER * float(np.median(errors)))
        if not bad.any():
            break
        left_out += [
            (view.name, f"its corners are {error:.2f} pixels off")
            for view, error, out in zip(used, errors, bad, strict=True)
            if out
        ]
        used = [view for view, out in zip(used, bad, strict=True) if not out]
    rectification = rig.rectify()
    rows = np.concatenate([_rows_apart(rig, rectification, view) for view in used])
    reprojection = np.sqrt(np.average(errors**2, weights=[len(view.points) for view in used]))
    return BoardCalibration(
        rig,
        rectification,
        tuple(used),
        tuple(left_out),
        float(reprojection),
        float(np.sqrt(np.mean(rows**2))),
        float(np.abs(rows).max()),
    )


def _solve(views: Sequence[View], size: tuple[int, int], model: str) -> tuple[StereoRig, Array]:
    """The rig, and each view's reprojection error (the worse camera's root mean square), pixels."""
    try:
        solved = _solve_fisheye(views, size) if model == FISHEYE else _solve_pinhole(views, size, model)
    except cv2.error as error:
        raise AnyNetError(
            "the views do not determine the cameras: show the board tilted, near and far, and at the borders"
        ) from error
    k1, d1, k2, d2, rotation, translation = (np.asarray(value, np.float64) for value in solved[:6])
    kind = FISHEYE if model == FISHEYE else PINHOLE
    rig = StereoRig(
        Camera(k1, d1.ravel(), kind), Camera(k2, d2.ravel(), kind), rotation, translation.ravel(), size,
        "anynet calibrate",
    )  # fmt: skip
    return rig, np.array([_error(rig, view) for view in views])


def _solve_pinhole(views: Sequence[View], size: tuple[int, int], model: str) -> list[Any]:
    points, lefts, rights = ([getattr(view, side) for view in views] for side in ("points", "left", "right"))
    flags = cv2.CALIB_RATIONAL_MODEL if model == "rational" else 0
    cameras: list[Any] = []
    for places in (lefts, rights):
        _, matrix, distortion, *_ = cv2.calibrateCamera(
            points, places, size, np.eye(3), np.zeros(5), flags=flags, criteria=_CRITERIA
        )
        cameras += [matrix, distortion]
    _, *solved = cv2.stereoCalibrate(
        points, lefts, rights, *cameras, size, flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS, criteria=_CRITERIA
    )  # type: ignore[call-overload]
    return list(solved)


def _solve_fisheye(views: Sequence[View], size: tuple[int, int]) -> list[Any]:
    points, lefts, rights = (
        [np.asarray(getattr(view, side), np.float64)[None] for view in views] for side in ("points", "left", "right")
    )
    # OpenCV 4 has these in cv2.fisheye, with other values than cv2's own of the same name.
    names = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2
    fixed, recompute, given = (
        getattr(names, f"CALIB_{name}") for name in ("FIX_SKEW", "RECOMPUTE_EXTRINSIC", "FIX_INTRINSIC")
    )
    cameras: list[Any] = []
    for places in (lefts, rights):
        guess = np.array([[size[0] / 2, 0, size[0] / 2], [0, size[0] / 2, size[1] / 2], [0, 0, 1]], np.float64)
        _, matrix, distortion, *_ = cv2.fisheye.calibrate(
            points, places, size, guess, np.zeros(4), flags=fixed | recompute, criteria=_CRITERIA
        )
        cameras += [matrix, distortion]
    _, *solved = cv2.fisheye.stereoCalibrate(
        points, lefts, rights, *cameras, size, flags=fixed | given, criteria=_CRITERIA
    )  # type: ignore[call-overload]
    return list(solved)


def _error(rig: StereoRig, view: View) -> float:
    """How far the board's corners lie from where one pose of it puts them in both images, root mean square."""
    left = _undistorted(rig.left, view.left)
    found, turn, place = cv2.solvePnP(view.points, left, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_ITERATIVE)
    if not found:
        return float("inf")
    pose = np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(place, np.float64).ravel()
    in_left = view.points.astype(np.float64) @ pose[0].T + pose[1]
    in_right = in_left @ rig.rotation.T + rig.translation
    return max(_distance(rig.left, in_left, view.left), _distance(rig.right, in_right, view.right))


def _undistorted(camera: Camera, places: npt.NDArray[np.float32]) -> Array:
    undistort = cv2.fisheye.undistortPoints if camera.model == FISHEYE else cv2.undistortPoints
    return np.asarray(undistort(places[:, None].astype(np.float64), camera.matrix, camera.distortion), np.float64)[:, 0]


def _distance(camera: Camera, points: Array, places: npt.NDArray[np.float32]) -> float:
    none = np.zeros(3)
    if camera.model == FISHEYE:
        projected, _ = cv2.fisheye.projectPoints(points[:, None], none, none, camera.matrix, camera.distortion)
    else:
        projected, _ = cv2.projectPoints(points, none, none, camera.matrix, camera.distortion)
    return float(np.sqrt(np.mean(np.sum((np.asarray(projected).reshape(-1, 2) - places) ** 2, axis=1))))


def _rows_apart(rig: StereoRig, rectification: Rectification, view: View) -> Array:
    """Right minus left row of each corner in the rectified images, pixels."""
    rows = []
    for camera, places, rotation, projection in zip(
        (rig.left, rig.right), (view.left, view.right), rectification.rotations, rectification.projections, strict=True
    ):
        rays = np.hstack([_undistorted(camera, places), np.ones((len(places), 1))]) @ rotation.T
        rows.append(rays[:, 1] / rays[:, 2] * projection[1, 1] + projection[1, 2])
    return np.asarray(rows[1] - rows[0], np.float64)
