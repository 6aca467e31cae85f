"""A calibrated rig as a YAML file that OpenCV, too, reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anynet.camera.rig import FISHEYE, StereoRig
from anynet.errors import AnyNetError
from anynet.io.files import write_atomically


def write_rig(path: str | Path, rig: StereoRig, report: Mapping[str, float] | None = None) -> None:
    """Writes raw and rectified cameras with OpenCV's names, atomically: K1, D1, K2, D2, R, T; R1, R2, P1, P2, Q.

    Lengths are meters. `images: raw` tells AnyNet's reader that the images that come with it are to be rectified.

    Args:
        path: the file, .yaml or .yml.
        rig: whose size is known.
        report: further numbers for the reader, such as errors.

    Raises:
        AnyNetError: if the rig's size is not known, or the file cannot be written.
    """
    if rig.size is None:
        raise AnyNetError("expected a rig whose images' size is known")
    rectification = rig.rectify()
    calibration = rectification.calibration
    q = np.array([
        [1, 0, 0, -(calibration.cx or 0)], [0, 1, 0, -(calibration.cy or 0)], [0, 0, 0, calibration.focal],
        [0, 0, 1 / calibration.baseline, calibration.doffs / calibration.baseline],
    ])  # fmt: skip
    matrices = {
        "K1": rig.left.matrix, "D1": rig.left.distortion[None], "K2": rig.right.matrix,
        "D2": rig.right.distortion[None], "R": rig.rotation, "T": rig.translation[:, None],
        "R1": rectification.rotations[0], "R2": rectification.rotations[1], "P1": rectification.projections[0],
        "P2": rectification.projections[1], "Q": q,
    }  # fmt: skip
    lines = [
        "%YAML:1.0", "---", "# AnyNet: raw cameras, and how their images are rectified. Meters, pixels.",
        f"image_width: {rig.size[0]}", f"image_height: {rig.size[1]}", "images: raw", "unit: m",
        f"model: {'fisheye' if rig.left.model == FISHEYE else 'pinhole'}",
    ]  # fmt: skip
    lines += [f"{name}: {value:.6g}" for name, value in (report or {}).items()]
    for name, matrix in matrices.items():
        lines += _matrix(name, matrix)
    write_atomically(path, ("\n".join(lines) + "\n").encode())


def _matrix(name: str, matrix: npt.NDArray[np.float64]) -> list[str]:
    numbers = ", ".join(repr(float(value)) for value in matrix.ravel())
    rows, columns = matrix.shape
    return [
        f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d", f"   data: [ {numbers} ]"
    ]  # fmt: skip
