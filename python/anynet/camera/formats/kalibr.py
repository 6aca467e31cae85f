"""Kalibr's camera chain and EuRoC's `sensor.yaml`, one for each camera: raw cameras. Meters.

Sources: https://github.com/ethz-asl/kalibr/wiki/yaml-formats; Burri et al., The EuRoC micro aerial vehicle datasets,
IJRR 2016.
"""

from __future__ import annotations

from collections.abc import Sequence

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Matrix, Request, from_rig
from anynet.camera.formats.models import camera, field, inverse, model_of, pose, size_of, text
from anynet.camera.rig import Camera, StereoRig
from anynet.camera.tree import Tree, numbers
from anynet.errors import AnyNetError


def recognizes_chain(documents: Sequence[Document]) -> bool:
    return all(any(map(_is_camera, (d.fields.get("cam0"), d.fields.get("cam1")))) for d in documents)


def _is_camera(node: Tree | None) -> bool:
    return isinstance(node, dict) and "intrinsics" in node


def read_chain(documents: Sequence[Document], request: Request) -> Found:
    fields: dict[str, Tree] = {}
    for document in documents:
        for name, node in document.fields.items():
            if fields.setdefault(name, node) != node:
                raise AnyNetError(f"expected {name} once, got different ones in {documents[0].path.name} and others")
    cameras = []
    for name in ("cam0", "cam1"):
        inner = field(fields, name)
        if not isinstance(inner, dict):
            raise AnyNetError(f"expected {name} to be a map of camera_model, intrinsics, ...")
        cameras.append(_camera(inner, name, "distortion_coeffs"))
    second = fields["cam1"]
    assert isinstance(second, dict)
    motion = pose(field(second, "T_cn_cnm1", "cam1"), "T_cn_cnm1")
    return _found("Kalibr", cameras, motion, request)


def recognizes_sensors(documents: Sequence[Document]) -> bool:
    return all("T_BS" in document.fields and "intrinsics" in document.fields for document in documents)


def read_sensors(documents: Sequence[Document], request: Request) -> Found:
    if len(documents) == 1:
        raise AnyNetError(
            "of one raw camera (EuRoC sensor.yaml): the other camera's file is needed too, as another --calib; or give "
            "the folder that has cam0 and cam1"
        )
    cameras = [_camera(document.fields, document.path.name, "distortion_coefficients") for document in documents]
    first, second = (pose(document.fields["T_BS"], "T_BS") for document in documents)  # from the camera to the body
    return _found("EuRoC", cameras, inverse(second) @ first, request)


def _camera(fields: dict[str, Tree], name: str, distortion: str) -> tuple[Camera, tuple[int, int] | None]:
    model_of(text(fields.get("camera_model")))
    model = model_of(text(fields.get("distortion_model")))
    coefficients = numbers(fields[distortion], distortion) if distortion in fields else numbers([], distortion)
    intrinsics = numbers(field(fields, "intrinsics", name), f"{name}'s intrinsics", 4)
    size = size_of(fields["resolution"], f"{name}'s resolution") if "resolution" in fields else None
    return camera(intrinsics, coefficients, model), size


def _found(
    origin: str, cameras: Sequence[tuple[Camera, tuple[int, int] | None]], motion: Matrix, request: Request
) -> Found:
    (left, size), (right, other) = cameras
    if size != other:
        raise AnyNetError(f"expected two cameras of one resolution, got {size} and {other}")
    found = Found(origin)
    translation = motion[:3, 3] * (request.meters or 1.0)
    from_rig(found, StereoRig(left, right, motion[:3, :3], translation, size, f"{origin}, raw cameras"))
    return found
