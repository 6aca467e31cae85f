"""Luxonis OAK (DepthAI): the device's calibration as JSON; raw cameras, centimeters.

Source: https://docs.luxonis.com, "Calibration" (EepromHandler, CalibrationHandler).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Matrix, Request, from_rig
from anynet.camera.formats.models import field, inverse, size_of, unknown_model
from anynet.camera.rig import FISHEYE, PINHOLE, Camera, StereoRig
from anynet.camera.tree import Tree, number, numbers, shortened
from anynet.errors import AnyNetError

_LEFT, _RIGHT = 1, 2  # sockets of the mono cameras, unless the file says so
_AUTO = -1  # the device's choice
_MODELS = {"": PINHOLE, "0": PINHOLE, "perspective": PINHOLE, "1": FISHEYE, "fisheye": FISHEYE}


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
    motion = _motion(cameras, *sockets)
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
    kind = str(fields.get("cameraType") or "").strip()
    if kind.lower() not in _MODELS:
        raise unknown_model(f"cameraType {shortened(kind)} of {where}")
    model = _MODELS[kind.lower()]
    distortion = numbers(fields.get("distortionCoeff", []), "distortionCoeff")
    if model == FISHEYE:
        distortion = distortion[:4]
    size = size_of([field(fields, "width", where), field(fields, "height", where)], "width and height")
    return Camera(matrix, distortion, model), size


def _motion(cameras: dict[int, dict[str, Tree]], left: int, right: int) -> Matrix:
    """From the left camera to the right one, [4, 4], by a camera that the extrinsics of both lead to."""
    first, second = _chain(cameras, left, right), _chain(cameras, right, left)
    ways = [inverse(second[socket]) @ first[socket] for socket in first if socket in second]
    if not ways:
        raise AnyNetError(
            f"expected extrinsics that lead from socket {left} to socket {right}, got chains that do not meet: "
            + " and ".join(" to ".join(map(str, chain)) for chain in (first, second))
        )
    motion = ways[0]
    for other in ways[1:]:  # of a circle: it has more than one way between the two
        turn, shift = (np.abs(other - motion)[:3, columns].max() for columns in (slice(3), 3))
        if turn > 0.01 or shift > 0.01 * np.linalg.norm(motion[:3, 3]):
            places = " and ".join(f"{np.linalg.norm(way[:3, 3]):g}" for way in (motion, other))
            raise AnyNetError(
                f"expected one place of socket {right} beside socket {left}, got extrinsics in a circle that tell "
                f"two, {places} away"
            )
    return motion


def _chain(cameras: dict[int, dict[str, Tree]], socket: int, goal: int) -> dict[int, Matrix]:
    """The motions [4, 4] from a camera to each that its extrinsics lead to, by sockets: up to the goal, or the end."""
    motions: dict[int, Matrix] = {socket: np.eye(4)}
    while socket != goal:
        extrinsics = cameras[socket].get("extrinsics") if socket in cameras else None
        if not isinstance(extrinsics, dict):
            break
        target = number(extrinsics.get("toCameraSocket", ""))
        if target is None or not 0 <= target < 100 or int(target) in motions:
            break
        step = np.eye(4)
        step[:3, :3] = numbers(field(extrinsics, "rotationMatrix"), "rotationMatrix", 9).reshape(3, 3)
        place = field(extrinsics, "translation")
        step[:3, 3] = numbers([place[axis] for axis in "xyz"] if isinstance(place, dict) and {*"xyz"} <= set(place)
                              else place, "translation", 3)  # fmt: skip
        motions[int(target)] = step @ motions[socket]
        socket = int(target)
    return motions
