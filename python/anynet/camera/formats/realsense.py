"""Intel RealSense: JSON with the intrinsics (fx, fy, ppx, ppy, as librealsense names them) of the rectified infrared
images, and their extrinsics (translation, meters) or baseline.

Source: https://github.com/IntelRealSense/librealsense (rs2_intrinsics, rs2_extrinsics).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Matrix, Request, camera_values, from_values, one_size
from anynet.camera.formats.models import size_of
from anynet.camera.formats.names import Names, plain
from anynet.camera.rig import vertical
from anynet.camera.tree import Tree, numbers, walk
from anynet.errors import AnyNetError

_INTRINSICS = ("fx", "fy", "ppx", "ppy")
_OTHER = ("color", "rgb", "fisheye")  # cameras that are not of the pair
_NO_CAMERAS = ("accel", "gyro", "imu", "motion", "pose")  # whose places are told, too
_ENDINGS = {"mm": 1e-3, "millimeters": 1e-3, "cm": 0.01, "centimeters": 0.01, "m": 1.0, "meters": 1.0}
_BASELINE = re.compile(rf"(stereo|infrared|infra|ir|depth|left|right)*baseline((in)?(?P<unit>{'|'.join(_ENDINGS)}))?")
_RIGHT = ("right", "infra2", "infrared2", "ir2")  # without underscores and the like


def recognizes(documents: Sequence[Document]) -> bool:
    return len(documents) == 1 and documents[0].kind in ("json", "yaml") and bool(_cameras(documents[0].tree))


def read(documents: Sequence[Document], request: Request) -> Found:
    tree = documents[0].tree
    cameras = _cameras(tree)
    right = next((fields for path, fields in cameras if _names_any(path, _RIGHT)), None)
    left = next((fields for _, fields in cameras if fields is not right), None)
    if left is None:
        raise AnyNetError("the calibration lacks the left infrared camera's fx, fy, ppx, ppy")
    found = Found("RealSense")
    found.values, found.size = _values(left, "left"), _size(left)
    if right is not None:
        from_values(found, found.values, _values(right, "right"))
        found.size = one_size(found.size, _size(right))
    elif any(_values(fields, "other") != found.values for _, fields in cameras):
        names = ", ".join(".".join(path) for path, _ in cameras)
        raise AnyNetError(f"expected one of the cameras to be called right or infra2, got {names}")
    for name, camera in (("left", left), ("right", right or {})):
        if "coeffs" in camera and numbers(camera["coeffs"], "coeffs").any():
            found.warnings.append(f"the {name} camera has distortion (coeffs): are the images rectified?")
    if _turned(tree):
        found.warnings.append("a camera is turned against the other (rotation): are the images rectified?")
    lengths = _lengths(tree)
    meters = [value * usual for value, usual in lengths.values()]
    if not meters:
        found.lacking["baseline"] = "extrinsics (translation) or baseline"
    elif max(meters) - min(meters) > 0.01 * max(meters):
        told = ", ".join(f"{where} {value:g}" for where, (value, _) in lengths.items())
        found.lacking["baseline"] = f"one place of the right infrared camera (it has {told})"
    else:
        value, usual = next(iter(lengths.values()))
        found.values["baseline"] = value * (request.meters or usual)
    return found


def _values(camera: dict[str, Tree], side: str) -> dict[str, float]:
    fx, fy, cx, cy = (float(numbers(camera[name], name, 1)[0]) for name in _INTRINSICS)
    return camera_values(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), f"the {side} camera")


def _size(camera: dict[str, Tree]) -> tuple[int, int] | None:
    told = "width" in camera and "height" in camera
    return size_of([camera["width"], camera["height"]], "width and height") if told else None


def _cameras(tree: Tree) -> list[tuple[tuple[str, ...], dict[str, Tree]]]:
    """By the names that lead to them."""
    found = []
    for path, node in _inside(tree):
        if isinstance(node, dict) and _is_camera(node) and not _names_any(path, _OTHER):
            found.append((path, node))
    return found


def _is_camera(node: Tree) -> bool:
    return isinstance(node, dict) and {*_INTRINSICS} <= {*node}


def _inside(tree: Tree) -> list[tuple[tuple[str, ...], Tree]]:
    """All nodes and the names that lead to them; without those of maps around the pair, such as the device's."""
    nodes = [((), tree), *walk(tree)]
    cameras = [path for path, node in nodes if _is_camera(node)]
    around = len([*takewhile(lambda names: len({*names}) == 1, zip(*cameras, strict=False))])
    if not any(_names_any(path[around:], _RIGHT) for path in cameras):
        return nodes
    return [(path[around:] if path[:around] == cameras[0][:around] else path, node) for path, node in nodes]


def _names_any(path: Sequence[str], words: Sequence[str]) -> bool:
    return any(word in plain(name) for name in path for word in words)


def _lengths(tree: Tree) -> dict[str, tuple[float, float]]:
    """What may be the baseline, by the names that lead to it, and the usual meters per unit: in meters or, as
    RealSense's stereo baseline option has it, millimeters. None is 0 unless all are: depth lies in the left camera."""
    found: dict[tuple[str, ...], tuple[float, float]] = {}
    told = Names(tree, ()).meters()
    for path, node in _inside(tree):
        name = plain(path[-1]) if path else ""
        if _names_any(path, _OTHER):
            continue
        if (baseline := _BASELINE.fullmatch(name)) and not isinstance(node, dict):
            value = abs(float(numbers(node, path[-1], 1)[0]))
            found[path] = value, _ENDINGS.get(baseline["unit"]) or told or _usual(value)
        elif name == "translation" and not _names_any(_holders(path), _NO_CAMERAS):
            value = _along(numbers(node, name, 3))
            found[path] = value, told or _usual(value)
    lengths = {path: length for path, length in found.items() if length[0]}
    lengths = {path: length for path, length in lengths.items() if _names_any(path, _RIGHT)} or lengths
    lengths = lengths or dict(list(found.items())[:1])
    return {".".join(path).lower(): length for path, length in lengths.items()}


def _turned(tree: Tree) -> bool:
    rotations = [
        numbers(node, path[-1])
        for path, node in _inside(tree)
        if path and plain(path[-1]) == "rotation" and not _names_any(_holders(path), (*_OTHER, *_NO_CAMERAS))
    ]
    return any(turn.size == 9 and np.abs(turn - np.eye(3).ravel()).max() > 0.01 for turn in rotations)


def _along(translation: Matrix) -> float:
    """How far a rectified camera stands from the other.

    Raises:
        AnyNetError: if that is not to its side.
    """
    x, y, z = translation
    if abs(y) > max(abs(x), abs(z)):
        raise AnyNetError(vertical(-y))
    if max(abs(y), abs(z)) > 0.05 * abs(x):
        raise AnyNetError(f"expected the translation of a rectified camera, along x, got {x:g} {y:g} {z:g}")
    return abs(float(x))


def _holders(path: Sequence[str]) -> Sequence[str]:
    """The maps around a place, but for `pose` in the right camera's map, which is that camera's."""
    own = len(path) > 2 and path[-2].lower() == "pose" and _names_any(path[-3:-2], _RIGHT)
    return path[:-2] if own else path[:-1]


def _usual(baseline: float) -> float:
    """Meters per unit, where nobody says it: none of its cameras is 1 m wide."""
    return 1e-3 if baseline > 1 else 1.0
