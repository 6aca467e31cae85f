"""Camera models and rigid motions, as the formats of robotics write them."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from anynet.camera.formats.found import Matrix
from anynet.camera.formats.names import plain
from anynet.camera.rig import FISHEYE, PINHOLE, Camera
from anynet.camera.tree import Tree, numbers
from anynet.errors import AnyNetError

_MODELS = {  # by plain names
    "": PINHOLE, "none": PINHOLE, "pinhole": PINHOLE, "perspective": PINHOLE, "rectilinear": PINHOLE, "radtan": PINHOLE,
    "radialtangential": PINHOLE, "plumbbob": PINHOLE, "rationalpolynomial": PINHOLE, "brownconrady": PINHOLE,
    "opencv": PINHOLE, "equidistant": FISHEYE, "fisheye": FISHEYE, "opencvfisheye": FISHEYE, "kannalabrandt": FISHEYE,
    "kannalabrandt4": FISHEYE, "kannalabrandt8": FISHEYE, "kb": FISHEYE, "kb4": FISHEYE, "kb8": FISHEYE,
}  # fmt: skip
# Other models, by names that say so in any text, and by those that are something else's unless they are all of it.
_OTHERS = {
    "omnidir", "omnidirectional", "doublesphere", "eucm", "ucm", "enhancedunified", "extendedunified", "scaramuzza",
    "ocamcalib", "fisheye62", "fisheye624", "fisheyerational", "thinprismfisheye", "radtanthinprismfisheye",
}  # fmt: skip
_OTHERS_ALONE = {
    "omni", "mei", "ds", "unified", "fov", "ftheta", "division", "spherical", "cylindrical", "orthographic",
    "catadioptric", "equisolid", "stereographic", "equirectangular",
}  # fmt: skip
_FILLERS = {"camera", "model", "lens", "distortion", "projection"}


def model_of(name: str) -> str:
    """The model of a distortion or camera model's name.

    Raises:
        AnyNetError: if it is another one.
    """
    known = plain(name).removeprefix("model")
    if known not in _MODELS:
        raise unknown_model(name)
    return _MODELS[known]


def model_of_text(text: str, of_a_lens: bool = False) -> str | None:
    """The model that a text in lower case names; None if it names none, but a camera. `of_a_lens`: perhaps a lens.

    Raises:
        AnyNetError: if it is another one.
    """
    words = [word for word in re.findall(r"[a-z0-9]+", text) if word not in _FILLERS]
    whole = "".join(words)
    if (whole in _OTHERS_ALONE and not of_a_lens) or not _OTHERS.isdisjoint(
        {whole, *words, *map("".join, pairwise(words))}
    ):
        raise unknown_model(text)
    if any(word in whole for word in ("fisheye", "equidistant", "kannala")):
        return FISHEYE
    return _MODELS.get(whole) if whole else None


def unknown_model(name: str) -> AnyNetError:
    """What is said of a lens that OpenCV's two models do not describe."""
    return AnyNetError(
        f"expected cameras of the models pinhole (radtan) or equidistant, got {name}: rectify the images with the "
        "tool that calibrated them, and give --focal and --baseline"
    )


def camera(focal_and_center: Matrix, distortion: Matrix, model: str) -> Camera:
    """A camera by fx, fy, cx, cy (pixels) and OpenCV's distortion coefficients."""
    fx, fy, cx, cy = focal_and_center
    if model == PINHOLE and 0 < distortion.size < 4:  # k1 k2, say
        distortion = np.concatenate([distortion, np.zeros(4 - distortion.size)])
    return Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64), distortion, model)


def pose(node: Tree, name: str) -> Matrix:
    """A rigid motion [4, 4], given as 3 x 4 or 4 x 4 numbers.

    Raises:
        AnyNetError: if it is none.
    """
    values = numbers(node, name)
    if values.size not in (12, 16) or not np.isfinite(values).all():
        raise AnyNetError(f"expected {name} to be a matrix of 4 x 4, got {values.size} numbers")
    matrix = np.vstack([values[:12].reshape(3, 4), [0, 0, 0, 1]])
    if np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max() > 0.01:
        raise AnyNetError(f"expected {name} to be a rotation and a translation")
    return matrix


def inverse(motion: Matrix) -> Matrix:
    """The inverse of a rigid motion [4, 4]."""
    result = np.eye(4)
    result[:3, :3] = motion[:3, :3].T
    result[:3, 3] = -motion[:3, :3].T @ motion[:3, 3]
    return result


def text(node: Tree | None) -> str:
    """A leaf's text; empty if it is none."""
    return node if isinstance(node, str) else ""


def size_of(node: Tree, name: str) -> tuple[int, int]:
    """Width and height.

    Raises:
        AnyNetError: if it is not that.
    """
    width, height = numbers(node, name, 2)
    if not (1 <= width <= 1e6 and 1 <= height <= 1e6):
        raise AnyNetError(f"expected {name} to be a width and height, got {width:g} {height:g}")
    return int(width), int(height)


def field(fields: dict[str, Tree], name: str, within: str = "") -> Tree:
    """A field that has to be there.

    Raises:
        AnyNetError: if it is not.
    """
    if name not in fields:
        raise AnyNetError(f"the calibration lacks {name}{f' of {within}' if within else ''}")
    return fields[name]
