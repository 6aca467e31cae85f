"""Point clouds."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt
from plyfile import PlyData, PlyElement

from anynet.errors import AnyNetError
from anynet.io.files import write_atomically


def write_ply(path: str | Path, points: npt.NDArray[np.float32], colors: npt.NDArray[np.uint8]) -> None:
    """Writes colored points as a binary PLY, atomically; points with a NaN are left out.

    Args:
        path: the file.
        points: float32 [..., 3], meters; x to the right, y down, z forward.
        colors: uint8 [..., 3], RGB of the same points.

    Raises:
        AnyNetError: if points and colors are not that, or the file cannot be written.
    """
    points, colors = np.asarray(points), np.asarray(colors)
    if points.shape[-1:] != (3,) or points.shape != colors.shape or colors.dtype != np.uint8:
        got = f"{points.dtype} {list(points.shape)} and {colors.dtype} {list(colors.shape)}"
        raise AnyNetError(f"{path}: expected points [..., 3] and their colors as uint8 [..., 3], got {got}")
    known = np.isfinite(points).all(axis=-1)
    fields = [(name, "<f4") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")]
    vertices = np.empty(np.count_nonzero(known), dtype=fields)
    for axis, name in enumerate("xyz"):
        vertices[name] = points[known][:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = colors[known][:, channel]
    buffer = io.BytesIO()
    comments = ["meters; x right, y down, z forward"]
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<", comments=comments).write(buffer)
    write_atomically(path, buffer.getvalue())
