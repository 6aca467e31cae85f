"""Luxonis OAK (DepthAI): the device's calibration as JSON; raw cameras, centimeters.

Source: https://docs.luxonis.com, "Calibration" (EepromHandler, CalibrationHandler).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Matrix, Request, from_rig
from anynet.camera.formats.models import field, inverse, size_of, text
from anynet.camera.rig import FISHEYE, PINHOLE, Camera, StereoRig
from anynet.camera.tree import Tree, number, numbers
from anynet.errors import AnyNetError

_LEFT, _RIGHT = 1, 2  # sockets of the mono cameras, unless the file says so
_AUTO = -1  # the device's choice


def recognizes(documents: Sequence[Document]) -> bool:
    return len(documents) == 1 and isinstance(documents[0].fields.get("cameraData"), list)


def read(documents: Sequence[Document], request: Request) -> Found:
    fields = documents[0].fields
    cameras = _cameras(fields["cameraData"])
    stereo = fields.get("stereoRectificationData")
    stereo = stereo if isinstance(stereo, dict) else {}
    sockets = [
        _socket(stereo.get(name, ""), usual)
        for name, usual in (("leftCameraSocket", _LEFT), ("rightCameraSocket", _RIGHT))
    ]
    if _AUTO in sockets:
        sockets = [_LEFT, _RIGHT]
    for socket in sockets:
        if socket not in cameras:
            raise AnyNetError(f"the calibration lacks the camera on socket {socket} (cameraData)")
    (left, size), (right, other) = (_camera(cameras[socket], socket) for socket in sockets)
    if size != other:
        raise AnyNetError(f"expected two cameras of one image size, got {size} and {other}")
    first, second = (_to_root(cameras, socket) for socket in sockets)
    motion = inverse(second) @ first
    found = Found("DepthAI")
    translation = motion[:3, 3] * (request.meters or 0.01)
    from_rig(found, StereoRig(left, right, motion[:3, :3], translation, size, "DepthAI, raw cameras"), "extrinsics")
    return found


def _socket(node: Tree, usual: int) -> int:
    told = number(node)
    return int(told) if told is not None and math.isfinite(told) else usual


def _cameras(node: Tree) -> dict[int, dict[str, Tree]]:
    cameras = {}
    for entry in node:
        if not isinstance(entry, list) or len(entry) != 2 or not isinstance(entry[1], dict):
            raise AnyNetError("expected cameraData to be pairs of a socket and a camera")
        socket = number(entry[0])
        if socket is None or not abs(socket) < 100:
            raise AnyNetError("expected cameraData to be pairs of a socket and a camera")
        cameras[int(socket)] = entry[1]
    return cameras


def _camera(fields: dict[str, Tree], socket: int) -> tuple[Camera, tuple[int, int]]:
    where = f"the camera on socket {socket}"
    matrix = numbers(field(fields, "intrinsicMatrix", where), "intrinsicMatrix", 9).reshape(3, 3)
    model = FISHEYE if text(fields.get("cameraType")).lower() in ("1", "fisheye") else PINHOLE
    distortion = numbers(fields.get("distortionCoeff", []), "distortionCoeff")
    if model == FISHEYE:
        distortion = distortion[:4]
    size = size_of([field(fields, "width", where), field(fields, "height", where)], "width and height")
    return Camera(matrix, distortion, model), size


def _to_root(cameras: dict[int, dict[str, Tree]], socket: int) -> Matrix:
    """From a camera to the one at the end of its chain of extrinsics, [4, 4]."""
    motion = np.eye(4)
    for _ in range(len(cameras)):
        extrinsics = cameras[socket].get("extrinsics") if socket in cameras else None
        if not isinstance(extrinsics, dict):
            break
        target = number(extrinsics.get("toCameraSocket", ""))
        if target is None or not 0 <= target < 100 or int(target) not in cameras:
            break
        step = np.eye(4)
        step[:3, :3] = numbers(field(extrinsics, "rotationMatrix"), "rotationMatrix", 9).reshape(3, 3)
        place = field(extrinsics, "translation")
        step[:3, 3] = numbers([place[axis] for axis in "xyz"] if isinstance(place, dict) and {*"xyz"} <= set(place)
                              else place, "translation", 3)  # fmt: skip
        motion, socket = step @ motion, int(target)
    return motion
