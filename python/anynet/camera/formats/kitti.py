"""KITTI's calibrations and those of data sets that use their fields, such as DrivingStereo (P_rect_101, P_rect_103).

`calib_cam_to_cam.txt` has P_rect_0i, and for the raw cameras K_, D_, R_, T_, S_0i; object, odometry and 2012 files have
P0 to P3; odometry's authors also leave the names out. Cameras 0, 1 are gray, 2, 3 color. Meters.
Source: Geiger, Lenz, Stiller, Urtasun, Vision meets Robotics: The KITTI Dataset, IJRR 2013.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Matrix, Request, from_projections
from anynet.camera.rig import Camera, StereoRig
from anynet.camera.tree import Tree, numbers
from anynet.errors import AnyNetError

_PROJECTION = re.compile(r"P(?:_rect_)?0*(\d{1,6})")


def recognizes(documents: Sequence[Document]) -> bool:
    (document,) = documents
    if document.kind == "numbers":
        return isinstance(document.tree, list) and len(_flat(document)) in (24, 48)
    return document.kind == "lines" and any(map(_PROJECTION.fullmatch, document.fields))


def read(documents: Sequence[Document], request: Request) -> Found:
    (document,) = documents
    fields = document.fields
    if document.kind == "numbers":
        rows = _flat(document).reshape(-1, 12)
        fields = {f"P{camera}": " ".join(map(str, row)) for camera, row in enumerate(rows)}
    if any(name.startswith("P_rect") for name in fields):
        fields = {name: value for name, value in fields.items() if not re.fullmatch(r"P\d+", name)}
    cameras = {int(match.group(1)): name for name in fields if (match := _PROJECTION.fullmatch(name))}
    left, right, pair = _choose(cameras, request)
    found = Found(f"KITTI, {pair}")
    first, second = (_projection(fields, cameras, camera) for camera in (left, right))
    from_projections(found, first, second, request.meters or 1.0, f"{cameras[right]}[3] = -focal * baseline")
    label = cameras[left].rpartition("_")[2]
    if f"S_rect_{label}" in fields:
        found.size = _size(fields, f"S_rect_{label}")
    found.rig = _raw(fields, label, cameras[right].rpartition("_")[2], request.meters or 1.0)
    return found


def _flat(document: Document) -> Matrix:
    return numbers(document.tree, "the file")


def _choose(cameras: Mapping[int, str], request: Request) -> tuple[int, int, str]:
    """The two cameras, and what is said of them."""
    if not set(cameras) <= {0, 1, 2, 3}:  # other data sets' numbers
        if len(cameras) != 2:
            raise AnyNetError(f"expected two cameras, got {', '.join(cameras.values())}")
        left, right = sorted(cameras)
        return left, right, f"cameras {cameras[left]} and {cameras[right]}"
    has = {"gray": 0 in cameras and 1 in cameras, "color": 2 in cameras and 3 in cameras}
    pair = request.pair
    if pair is None and all(has.values()) and request.images is not None:
        path = request.images.absolute()  # an image, or a folder of them
        if any(re.fullmatch(r"image_0?[01]", folder.name) for folder in (path, *path.parents[:2])):
            pair = "gray"
    if pair is None:
        pair = "color" if has["color"] or not (has["gray"] or 0 in cameras or 1 in cameras) else "gray"
        if not any(has.values()) and (2 in cameras or 3 in cameras):
            pair = "color"
    left = {"gray": 0, "color": 2}[pair]
    return left, left + 1, f"{pair} pair (cameras {left} and {left + 1})"


def _projection(fields: Mapping[str, Tree], cameras: Mapping[int, str], camera: int) -> Matrix:
    if camera not in cameras:
        some = next(iter(cameras.values()), "P_rect_02")
        name = re.sub(r"\d+", lambda digits: f"{camera:0{len(digits.group())}}", some)
        raise AnyNetError(f"the calibration lacks {name}")
    return numbers(fields[cameras[camera]], cameras[camera], 12).reshape(3, 4)


def _size(fields: Mapping[str, Tree], name: str) -> tuple[int, int]:
    size = numbers(fields[name], name, 2)
    if not (np.isfinite(size).all() and (np.abs(size) < 1e9).all()):
        raise AnyNetError(f"expected {name} to be a width and height, got {size[0]:g} {size[1]:g}")
    return int(size[0]), int(size[1])


def _raw(fields: Mapping[str, Tree], left: str, right: str, meters: float) -> StereoRig | None:
    """The raw cameras of a `calib_cam_to_cam.txt`; R and T lead from camera 0 to each."""
    if not all(f"{letter}_{label}" in fields for letter in "KDRTS" for label in (left, right)):
        return None
    cameras, rotations, translations = [], [], []
    for label in (left, right):
        matrix, rotation = (numbers(fields[f"{x}_{label}"], f"{x}_{label}", 9).reshape(3, 3) for x in "KR")
        cameras.append(Camera(matrix, numbers(fields[f"D_{label}"], f"D_{label}", 5)))
        rotations.append(rotation)
        translations.append(numbers(fields[f"T_{label}"], f"T_{label}", 3) * meters)
    rotation = rotations[1] @ rotations[0].T
    translation = translations[1] - rotation @ translations[0]
    return StereoRig(cameras[0], cameras[1], rotation, translation, _size(fields, f"S_{left}"), "KITTI, raw cameras")
