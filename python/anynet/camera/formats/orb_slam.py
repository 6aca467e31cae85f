"""Settings of ORB-SLAM2 and ORB-SLAM3. Camera.bf = focal * baseline, Stereo.b and Stereo.T_c1_c2 in meters.

Camera.fx with Camera.bf or Stereo.b: of rectified images. Camera1.* and Camera2.*, LEFT.* and RIGHT.*: of raw ones.
Source: the settings in https://github.com/raulmur/ORB_SLAM2 and https://github.com/UZ-SLAMLab/ORB_SLAM3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Matrix, Request, camera_values, from_projections, from_rig, one_size
from anynet.camera.formats.models import camera, field, inverse, model_of, pose, size_of, text
from anynet.camera.rig import FISHEYE, Camera, StereoRig
from anynet.camera.tree import Tree, numbers
from anynet.errors import AnyNetError

_POSES = ("Stereo.T_c1_c2", "Tlr")  # from the right camera to the left


def recognizes(documents: Sequence[Document]) -> bool:
    fields = documents[0].fields
    return len(documents) == 1 and any(name in fields for name in ("Camera.fx", "Camera1.fx", "LEFT.P"))


def read(documents: Sequence[Document], request: Request) -> Found:
    fields = documents[0].fields
    meters = request.meters or 1.0
    found = Found("ORB-SLAM")
    if "Camera.width" in fields and "Camera.height" in fields:
        found.size = size_of([fields["Camera.width"], fields["Camera.height"]], "Camera.width and Camera.height")
    if "LEFT.P" in fields or "RIGHT.P" in fields:
        return _with_rectification(found, fields, meters)
    first = "Camera1" if "Camera1.fx" in fields else "Camera"
    motion = next((name for name in _POSES if name in fields), None)
    if "Camera2.fx" in fields and motion is not None:
        transform = inverse(pose(fields[motion], motion))
        left, right = (_camera(fields, name) for name in (first, "Camera2"))
        rig = StereoRig(left, right, transform[:3, :3], transform[:3, 3] * meters, found.size, "ORB-SLAM, raw cameras")
        from_rig(found, rig)
        return found
    left = _camera(fields, first)
    if left.distorted and text(fields.get("Camera.type")) != "Rectified":
        raise AnyNetError(
            f"of unrectified cameras ({first}.k1, ... are not 0): the calibration lacks Camera2.fx and Stereo.T_c1_c2; "
            "rectify the images first, and give --focal and --baseline"
        )
    found.values = camera_values(left.matrix, first)
    focal = found.values["focal"]
    if "Stereo.b" in fields:
        found.values["baseline"] = float(numbers(fields["Stereo.b"], "Stereo.b", 1)[0]) * meters
    elif "Camera.bf" in fields:
        found.values["baseline"] = float(numbers(fields["Camera.bf"], "Camera.bf", 1)[0]) / focal * meters
    else:
        found.lacking["baseline"] = "Camera.bf or Stereo.b"
    return found


def _camera(fields: dict[str, Tree], name: str) -> Camera:
    values = [numbers(field(fields, f"{name}.{part}"), f"{name}.{part}", 1) for part in ("fx", "fy", "cx", "cy")]
    model = model_of(text(fields.get("Camera.type")).replace("Rectified", ""))
    parts = ("k1", "k2", "k3", "k4") if model == FISHEYE else ("k1", "k2", "p1", "p2", "k3")
    distortion = [
        numbers(fields[f"{name}.{part}"], f"{name}.{part}", 1) if f"{name}.{part}" in fields else np.zeros(1)
        for part in parts
    ]
    return camera(np.concatenate(values), np.concatenate(distortion), model)


def _with_rectification(found: Found, fields: dict[str, Tree], meters: float) -> Found:
    """ORB-SLAM2 rectifies by these itself: its images are raw."""
    sides = ("LEFT", "RIGHT")
    projections = [_matrix(fields, f"{side}.P", 3, 4) for side in sides]
    for projection in projections:
        projection[:, 3] *= meters
    from_projections(found, projections[0], projections[1], 1.0, "RIGHT.P[0, 3] = -focal * baseline")
    if all(f"{side}.{name}" in fields for side in sides for name in "KDR"):
        left, right = (
            Camera(_matrix(fields, f"{side}.K", 3, 3), numbers(fields[f"{side}.D"], f"{side}.D")) for side in sides
        )
        rotations = [_matrix(fields, f"{side}.R", 3, 3) for side in sides]
        along = (projections[1][:, 3] - projections[0][:, 3]) / projections[0][0, 0]
        found.size = one_size(*(_size(fields, side) for side in sides))
        rotation = rotations[1].T @ rotations[0]
        found.rig = StereoRig(left, right, rotation, rotations[1].T @ along, found.size, "ORB-SLAM, raw cameras")
        found.raw = not found.rig.is_rectified
    return found


def _size(fields: dict[str, Tree], side: str) -> tuple[int, int] | None:
    names = f"{side}.width", f"{side}.height"
    return size_of([fields[name] for name in names], " and ".join(names)) if {*names} <= {*fields} else None


def _matrix(fields: dict[str, Tree], name: str, rows: int, columns: int) -> Matrix:
    return numbers(field(fields, name), name, rows * columns).reshape(rows, columns)
