"""Intel RealSense: JSON with the intrinsics (fx, fy, ppx, ppy, as librealsense names them) of the rectified infrared
images, and their extrinsics (translation, meters) or baseline.

Source: https://github.com/IntelRealSense/librealsense (rs2_intrinsics, rs2_extrinsics).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Request, camera_values, from_values
from anynet.camera.formats.models import size_of
from anynet.camera.tree import Tree, numbers, walk
from anynet.errors import AnyNetError

_INTRINSICS = ("fx", "fy", "ppx", "ppy")
_OTHER = ("color", "rgb", "fisheye")  # cameras that are not of the pair
_NO_CAMERAS = ("accel", "gyro", "imu", "motion", "pose")  # whose places are told, too
_BASELINE = re.compile(r"((stereo|ir|infrared)_?)?baseline(_?(m|mm|meters|millimeters))?")  # no baseline_uncertainty
_RIGHT = ("right", "infra2", "infrared2", "infrared_2", "ir2", "infra_2")


def recognizes(documents: Sequence[Document]) -> bool:
    return len(documents) == 1 and documents[0].kind in ("json", "yaml") and bool(_cameras(documents[0].tree))


def read(documents: Sequence[Document], request: Request) -> Found:
    tree = documents[0].tree
    cameras = _cameras(tree)
    right = next((fields for name, fields in cameras if any(word in name for word in _RIGHT)), None)
    left = next((fields for _, fields in cameras if fields is not right), None)
    if left is None:
        raise AnyNetError("the calibration lacks the left infrared camera's fx, fy, ppx, ppy")
    found = Found("RealSense")
    found.values, found.size = _values(left, "left"), _size(left)
    if right is not None:
        from_values(found, found.values, _values(right, "right"))
        size = _size(right)
        found.size = found.size or size
        if size not in (None, found.size):
            raise AnyNetError(f"expected one width and height of both cameras, got {found.size} and {size}")
    for name, camera in (("left", left), ("right", right or {})):
        if "coeffs" in camera and numbers(camera["coeffs"], "coeffs").any():
            found.warnings.append(f"the {name} camera has distortion (coeffs): are the images rectified?")
    baseline = _baseline(tree)
    if baseline is None:
        found.lacking["baseline"] = "extrinsics (translation) or baseline"
    else:
        found.values["baseline"] = baseline * (request.meters or _usual(baseline))
    return found


def _values(camera: dict[str, Tree], side: str) -> dict[str, float]:
    fx, fy, cx, cy = (float(numbers(camera[name], name, 1)[0]) for name in _INTRINSICS)
    return camera_values(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), f"the {side} camera")


def _size(camera: dict[str, Tree]) -> tuple[int, int] | None:
    told = "width" in camera and "height" in camera
    return size_of([camera["width"], camera["height"]], "width and height") if told else None


def _cameras(tree: Tree) -> list[tuple[str, dict[str, Tree]]]:
    """By the names that lead to them."""
    nodes = [((), tree), *walk(tree)]
    found = []
    for path, node in nodes:
        name = ".".join(path).lower()
        if isinstance(node, dict) and {*_INTRINSICS} <= {*node} and not any(word in name for word in _OTHER):
            found.append((name, node))
    return found


def _baseline(tree: Tree) -> float | None:
    """In meters or, as RealSense's stereo baseline option has it, millimeters.

    Raises:
        AnyNetError: if the file names several.
    """
    found = {}
    for path, node in walk(tree):
        where, name = ".".join(path).lower(), path[-1].lower()
        if _BASELINE.fullmatch(name) and not isinstance(node, dict):
            found[where] = abs(float(numbers(node, name, 1)[0]))
        elif name == "translation" and not any(word in where for word in _OTHER + _NO_CAMERAS):
            found[where] = float(np.linalg.norm(numbers(node, name, 3)))
    lengths = {where: value for where, value in found.items() if value}  # depth lies in the left camera
    lengths = {where: value for where, value in lengths.items() if any(word in where for word in _RIGHT)} or lengths
    meters = [value * _usual(value) for value in lengths.values()]
    if meters and max(meters) - min(meters) > 0.01 * max(meters):
        told = ", ".join(f"{where} {value:g}" for where, value in lengths.items())
        raise AnyNetError(f"expected the place of the right infrared camera once, got {told}")
    return next(iter((lengths or found).values()), None)


def _usual(baseline: float) -> float:
    """Meters per unit, where nobody says it: none of its cameras is 1 m wide."""
    return 1e-3 if baseline > 1 else 1.0
