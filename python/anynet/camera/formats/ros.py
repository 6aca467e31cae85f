"""ROS and ROS 2: camera_info of the left and the right camera, as calibration files or as messages printed by a tool.

P is of the rectified images; K, D and R of the raw ones. P[0, 3] = -focal * baseline of the right camera. Meters.
Source: sensor_msgs/CameraInfo's definition; http://wiki.ros.org/camera_calibration_parsers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Matrix, Request, camera_values, from_projections
from anynet.camera.formats.models import field, model_of, size_of, text
from anynet.camera.rig import Camera, StereoRig
from anynet.camera.tree import Tree, numbers
from anynet.errors import AnyNetError

# The names in files, in ROS messages, and in ROS 2's.
_NAMES = (
    {"P": "projection_matrix", "K": "camera_matrix", "D": "distortion_coefficients", "R": "rectification_matrix",
     "width": "image_width", "height": "image_height"},
    {"P": "P", "K": "K", "D": "D", "R": "R", "width": "width", "height": "height"},
    {"P": "p", "K": "k", "D": "d", "R": "r", "width": "width", "height": "height"},
)  # fmt: skip


@dataclass(frozen=True)
class _Info:
    name: str
    projection: Matrix
    rotation: Matrix
    camera: Camera
    size: tuple[int, int] | None


def recognizes(documents: Sequence[Document]) -> bool:
    return all(document.kind in ("yaml", "json") and _names(document.fields) is not None for document in documents)


def read(documents: Sequence[Document], request: Request) -> Found:
    infos = [_info(document, request.meters or 1.0) for document in documents]
    found = Found("ROS camera_info", size=infos[0].size)
    if len(infos) == 1:
        if infos[0].projection[0, 3]:
            raise AnyNetError(
                "camera_info of the right camera alone (P[0, 3] is not 0): the left one's file is needed too, as "
                "another --calib"
            )
        found.values = camera_values(infos[0].projection, "P")
        found.lacking["baseline"] = "the right camera's camera_info (as another --calib), whose P[0, 3] tells it"
        return found
    left, right = sorted(infos, key=lambda info: -info.projection[0, 3])
    if left.size != right.size:
        raise AnyNetError(f"expected camera_info of one image size, got {left.size} and {right.size}")
    lacking = "P[0, 3] = -focal * baseline of the right camera (it is 0: was each camera calibrated alone?)"
    from_projections(found, left.projection, right.projection, 1.0, lacking)
    along = (right.projection[:, 3] - left.projection[:, 3]) / left.projection[0, 0]
    rotation = right.rotation.T @ left.rotation
    rig = StereoRig(left.camera, right.camera, rotation, right.rotation.T @ along, left.size, "ROS, raw cameras")
    found.rig = rig if rig.baseline > 0 and not rig.is_rectified else None
    return found


def _names(fields: dict[str, Tree]) -> dict[str, str] | None:
    for names in _NAMES:
        if names["P"] in fields and names["K"] in fields and (names["R"] in fields or "distortion_model" in fields):
            return names
    return None


def _info(document: Document, meters: float) -> _Info:
    fields = document.fields
    names = _names(fields)
    assert names is not None
    projection = numbers(fields[names["P"]], names["P"], 12).reshape(3, 4)
    if not projection[:, :3].any():
        raise AnyNetError(f"{document.path.name}: {names['P']} is 0: the camera was not calibrated")
    if not np.isfinite(projection).all():
        raise AnyNetError(f"{document.path.name}: expected {names['P']} of finite numbers")
    projection[:, 3] *= meters
    matrix = numbers(fields[names["K"]], names["K"], 9).reshape(3, 3)
    distortion = numbers(fields[names["D"]], names["D"]) if names["D"] in fields else np.zeros(0)
    model = model_of(text(fields.get("distortion_model")))
    rotation = numbers(field(fields, names["R"]), names["R"], 9).reshape(3, 3)
    size = None
    if text(fields.get(names["width"])).strip("0 ") and names["height"] in fields:
        size = size_of([fields[names["width"]], fields[names["height"]]], "the image size")
    return _Info(document.path.name, projection, rotation, Camera(matrix, distortion, model), size)
