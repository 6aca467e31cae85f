"""ZED's factory calibration, SN*.conf: raw cameras at several resolutions; millimeters and radians.

Source: https://github.com/stereolabs/zed-opencv-native (how it rectifies by these values).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Request, from_rig
from anynet.camera.formats.models import camera, field
from anynet.camera.rig import Camera, StereoRig
from anynet.camera.tree import Tree, numbers
from anynet.errors import AnyNetError

_SIZES = {
    "2K": (2208, 1242), "FHD": (1920, 1080), "FHD1200": (1920, 1200), "HD": (1280, 720), "SVGA": (960, 600),
    "VGA": (672, 376),
}  # fmt: skip
_PREFIX = "LEFT_CAM_"
_DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # the first two are in every file


def recognizes(documents: Sequence[Document]) -> bool:
    fields = documents[0].fields
    return len(documents) == 1 and any(name.startswith(_PREFIX) for name in fields)


def read(documents: Sequence[Document], request: Request) -> Found:
    fields = documents[0].fields
    there = [name.removeprefix(_PREFIX) for name in fields if name.startswith(_PREFIX)]
    fitting = [name for name in there if request.size is not None and _SIZES.get(name) == request.size]
    if len(there) > 1 and not fitting:
        sizes = ", ".join(f"{name} ({w} x {h})" for name, (w, h) in _SIZES.items() if name in there)
        got = "unknown" if request.size is None else "{} x {}".format(*request.size)
        raise AnyNetError(f"expected images of one of the calibration's sizes {sizes}, got {got}")
    resolution = fitting[0] if fitting else there[0]
    left, right = (_camera(fields, side, resolution) for side in ("LEFT", "RIGHT"))
    stereo = _section(fields, "STEREO")
    baseline = _value(stereo, "Baseline", "STEREO")
    rest = [_optional(stereo, name, f"{name}_{resolution}") for name in ("TY", "TZ")]
    angles = np.array([_angle(stereo, name, resolution) for name in ("RX", "CV", "RZ")])
    if not np.isfinite(angles).all():
        raise AnyNetError("expected RX, CV and RZ to be finite angles")
    rotation = np.asarray(cv2.Rodrigues(angles)[0], np.float64)
    # The file has the right camera's place, so to say; OpenCV's translation is its opposite.
    translation = -np.array([baseline, *rest]) * (request.meters or 1e-3)
    found = Found(f"ZED, {resolution}")
    origin = f"ZED {resolution}, raw cameras"
    from_rig(found, StereoRig(left, right, rotation, translation, _SIZES.get(resolution), origin), "Baseline")
    return found


def _section(fields: dict[str, Tree], name: str) -> dict[str, Tree]:
    section = field(fields, name)
    if not isinstance(section, dict):
        raise AnyNetError(f"expected [{name}] to be a section")
    return section


def _camera(fields: dict[str, Tree], side: str, resolution: str) -> Camera:
    name = f"{side}_CAM_{resolution}"
    section = _section(fields, name)
    intrinsics = np.array([_value(section, part, name) for part in ("fx", "fy", "cx", "cy")])
    shared = fields.get(f"{side}_DISTO")
    bends, within = (shared, f"{side}_DISTO") if isinstance(shared, dict) else (section, name)
    always = [_value(bends, part, within) for part in _DISTORTION[:2]]
    distortion = np.array([*always, *(_optional(bends, part) for part in _DISTORTION[2:])])
    return camera(intrinsics, distortion if distortion[5:].any() else distortion[:5], "pinhole")


def _angle(stereo: dict[str, Tree], name: str, resolution: str) -> float:
    own = f"{name}_{resolution}"
    return _value(stereo, name if name in stereo and own not in stereo else own, "STEREO")


def _value(section: dict[str, Tree], name: str, within: str) -> float:
    return float(numbers(field(section, name, within), name, 1)[0])


def _optional(section: dict[str, Tree], *names: str) -> float:
    return next((_value(section, name, "") for name in names if name in section), 0.0)
