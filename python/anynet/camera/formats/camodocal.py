"""camodocal's camera files, and the settings of VINS-Fusion that name them and hold body_T_cam0, body_T_cam1. Meters.

Source: https://github.com/hengli/camodocal; https://github.com/HKUST-Aerial-Robotics/VINS-Fusion.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from anynet.camera.document import Document, open_document
from anynet.camera.formats.found import Found, Request, from_rig
from anynet.camera.formats.models import camera, field, inverse, model_of, pose, size_of, text
from anynet.camera.rig import FISHEYE, Camera, StereoRig
from anynet.camera.tree import Tree, numbers
from anynet.errors import AnyNetError

_POSES = ("body_T_cam0", "body_T_cam1")
_PARAMETERS = {  # of the intrinsics and of the distortion, in OpenCV's order
    "pinhole": (("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2")),
    FISHEYE: (("mu", "mv", "u0", "v0"), ("k2", "k3", "k4", "k5")),
}


def recognizes(documents: Sequence[Document]) -> bool:
    return all("model_type" in document.fields or _POSES[0] in document.fields for document in documents)


def read(documents: Sequence[Document], request: Request) -> Found:
    cameras = [document for document in documents if "model_type" in document.fields]
    rigs = [document for document in documents if "model_type" not in document.fields]
    names = [text(rig.fields.get(f"cam{number}_calib")) for rig in rigs[:1] for number in (0, 1)]
    found = Found("VINS")
    if names and all(names):
        folder = rigs[0].path.parent
        cameras = _named(names, folder, cameras, found) if cameras else [open_document(folder / name) for name in names]
    if len(cameras) != 2 or len(rigs) != 1:
        raise AnyNetError(
            "of unrectified cameras (model_type): expected the files of both cameras and the one with "
            f"{' and '.join(_POSES)}, each as a --calib, got {len(cameras)} and {len(rigs)}; "
            "or rectify the images first, and give --focal and --baseline"
        )
    (left, size), (right, other) = (_camera(document) for document in cameras)
    if size != other:
        raise AnyNetError(f"expected two cameras of one image size, got {size} and {other}")
    first, second = (pose(field(rigs[0].fields, name), name) for name in _POSES)  # from the camera to the body
    motion = inverse(second) @ first
    translation = motion[:3, 3] * (request.meters or 1.0)
    from_rig(found, StereoRig(left, right, motion[:3, :3], translation, size, "VINS, raw cameras"))
    return found


def _named(names: Sequence[str], folder: Path, cameras: list[Document], found: Found) -> list[Document]:
    """The cameras in the order of the settings, which lie in the folder; in the options' order if those name others.

    Raises:
        AnyNetError: if the settings name one of them, but not the other.
    """
    form: Callable[[str], str]
    for form in (os.path.abspath, os.path.basename):
        wanted = [form(str(folder / name)) for name in names]
        given = {form(str(camera.path)): camera for camera in cameras}
        if len(given) == len(cameras) and given.keys() == {*wanted}:
            return [given[path] for path in wanted]
    got = " and ".join(camera.path.name for camera in cameras)
    told = f"expected the cameras {' and '.join(names)} that the settings name, got {got}"
    if len({*wanted}) == len(given) == len(cameras) and not given.keys().isdisjoint(wanted):
        raise AnyNetError(told)
    found.warnings.append(f"{told}: the first is taken for the left one")
    return cameras


def _camera(document: Document) -> tuple[Camera, tuple[int, int] | None]:
    fields = document.fields
    model = model_of(text(field(fields, "model_type", document.path.name)))
    intrinsics, distortion = _PARAMETERS[model]
    outer = field(fields, "projection_parameters", document.path.name)
    bends = outer if model == FISHEYE else fields.get("distortion_parameters", {})
    if not isinstance(outer, dict) or not isinstance(bends, dict):
        raise AnyNetError(f"{document.path.name}: expected projection_parameters and distortion_parameters to be maps")
    size = None
    if "image_width" in fields and "image_height" in fields:
        size = size_of([fields["image_width"], fields["image_height"]], "image_width and image_height")
    bends = {**dict.fromkeys(distortion, "0"), **bends}
    return camera(_values(outer, intrinsics), _values(bends, distortion), model), size


def _values(fields: dict[str, Tree], names: Sequence[str]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([numbers(field(fields, name), name, 1)[0] for name in names])
