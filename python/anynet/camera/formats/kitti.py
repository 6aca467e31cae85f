"""KITTI's calibrations and those of data sets that use their fields, such as DrivingStereo (P_rect_101, P_rect_103).

`calib_cam_to_cam.txt` has P_rect_0i, and for the raw cameras K_, D_, R_, T_, S_0i; object, odometry and 2012 files have
P0 to P3; odometry's authors also leave the names out. Cameras 0, 1 are gray, 2, 3 color. The older Karlsruhe sequences
have cameras 1 and 2: P1_roi and P2_roi of the published images, which are rectified and cut out (roi: first and last
column, first and last row), P1 and P2 of the whole ones, and K1, D1, K2, D2, R, T of the raw ones. Meters.
Sources: Geiger, Lenz, Stiller, Urtasun, Vision meets Robotics: The KITTI Dataset, IJRR 2013; CalibIO of Geiger's
libviso, for the Karlsruhe sequences.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Matrix, Request, from_projections, from_rig, one_size
from anynet.camera.rig import Camera, StereoRig
from anynet.camera.tree import Tree, numbers
from anynet.errors import AnyNetError

_PROJECTION = re.compile(r"P(?:_rect_)?0*(\d{1,6})")
_CAMERA = re.compile(r"(?:P(?:_rect_)?|K_?)\d{1,6}")
_RAW = "KDRTS"  # of each camera, raw


def recognizes(documents: Sequence[Document]) -> bool:
    (document,) = documents
    if document.kind == "numbers":
        return isinstance(document.tree, list) and len(_flat(document)) in (24, 48)
    return document.kind == "lines" and any(map(_CAMERA.fullmatch, document.fields))


def read(documents: Sequence[Document], request: Request) -> Found:
    (document,) = documents
    fields = document.fields
    if document.kind == "numbers":
        rows = _flat(document).reshape(-1, 12)
        fields = {f"P{camera}": " ".join(map(str, row)) for camera, row in enumerate(rows)}
    if "K1" in fields or "P1_roi" in fields:
        return _karlsruhe(fields, request.meters or 1.0)
    if not any(map(_PROJECTION.fullmatch, fields)):
        return _raw_alone(fields, request)
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
    labels = label, cameras[right].rpartition("_")[2]
    lacking = _lacking(fields, labels)
    if not lacking:
        found.rig = _raw(fields, *labels, request.meters or 1.0)
    elif len(lacking) < len(_RAW) * 2:
        found.origin += f"; of the raw cameras it lacks {', '.join(lacking)}"
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


def _lacking(fields: Mapping[str, Tree], labels: Sequence[str]) -> list[str]:
    """What is not told of the raw cameras."""
    return [name for label in labels for letter in _RAW if (name := f"{letter}_{label}") not in fields]


def _lacks(rectified: str, raw: Sequence[str]) -> AnyNetError:
    return AnyNetError(
        f"the calibration lacks {rectified} of rectified images; of the raw cameras, to rectify by, {', '.join(raw)}"
    )


def _raw_alone(fields: Mapping[str, Tree], request: Request) -> Found:
    """Of a file that says nothing of rectified images."""
    there = {int(name[2:]): name[2:] for name in fields if re.fullmatch(r"K_\d{1,6}", name)}
    left, right, pair = _choose({number: f"K_{label}" for number, label in there.items()}, request)
    labels = [there.get(number, f"{number:02}") for number in (left, right)]
    lacking = _lacking(fields, labels)
    if lacking:
        raise _lacks(" and ".join(f"P_rect_{label}" for label in labels), lacking)
    found = Found(f"KITTI, {pair}")
    from_rig(found, _raw(fields, labels[0], labels[1], request.meters or 1.0), f"T_{labels[1]}")
    return found


def _karlsruhe(fields: Mapping[str, Tree], meters: float) -> Found:
    """The cameras 1 and 2 of one file."""
    found = Found("Karlsruhe, cameras 1 and 2")
    raw = [name for name in ("K1", "D1", "K2", "D2", "R", "T") if name not in fields]
    names = next((pair for pair in (("P1_roi", "P2_roi"), ("P1", "P2")) if all(name in fields for name in pair)), None)
    if names is None and raw:
        raise _lacks("P1_roi and P2_roi", raw)
    if not raw:
        matrices = (numbers(fields[name], name, 9).reshape(3, 3) for name in ("K1", "K2"))
        bends = (numbers(fields[name], name) for name in ("D1", "D2"))
        left, right = (Camera(matrix, bend) for matrix, bend in zip(matrices, bends, strict=True))
        rotation, translation = numbers(fields["R"], "R", 9).reshape(3, 3), numbers(fields["T"], "T", 3) * meters
        found.rig = StereoRig(left, right, rotation, translation, None, "Karlsruhe, raw cameras")
    if names is not None:
        first, second = (numbers(fields[name], name, 12).reshape(3, 4) for name in names)
        from_projections(found, first, second, meters, f"{names[1]}[3] = -focal * baseline")
        found.origin += f" ({names[0]}, {names[1]})"
        if names[0] == "P1_roi" and "roi" in fields:
            begin, end, top, bottom = numbers(fields["roi"], "roi", 4)
            if not (0 <= begin < end < 1e6 and 0 <= top < bottom < 1e6):
                raise AnyNetError(f"expected roi as first and last column, first and last row, got {fields['roi']}")
            found.size = int(end - begin) + 1, int(bottom - top) + 1
    return found


def _raw(fields: Mapping[str, Tree], left: str, right: str, meters: float) -> StereoRig:
    """The raw cameras of a `calib_cam_to_cam.txt`; R and T lead from camera 0 to each."""
    cameras, rotations, translations = [], [], []
    for label in (left, right):
        matrix, rotation = (numbers(fields[f"{x}_{label}"], f"{x}_{label}", 9).reshape(3, 3) for x in "KR")
        cameras.append(Camera(matrix, numbers(fields[f"D_{label}"], f"D_{label}", 5)))
        rotations.append(rotation)
        translations.append(numbers(fields[f"T_{label}"], f"T_{label}", 3) * meters)
    rotation = rotations[1] @ rotations[0].T
    translation = translations[1] - rotation @ translations[0]
    size = one_size(*(_size(fields, f"S_{label}") for label in (left, right)))
    return StereoRig(cameras[0], cameras[1], rotation, translation, size, "KITTI, raw cameras")
