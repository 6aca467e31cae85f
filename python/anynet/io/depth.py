"""Depth maps. In memory: float32 [H, W], meters, NaN where unknown."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, PngImagePlugin

from anynet.errors import AnyNetError
from anynet.io.disparity import as_map, read_disparity
from anynet.io.files import write_atomically
from anynet.io.images import open_image

_MILLIMETERS = 1000  # PNG levels per meter, as ROS (REP 118) and RGB-D tools have it
_SCALE = "LevelsPerMeter"  # the name under which a PNG of ours says so


def read_depth(path: str | Path, scale: float | None = None) -> npt.NDArray[np.float32]:
    """Reads a depth map, meters, from TIFF, NPY, NPZ, PFM or PNG.

    Args:
        path: the file; in a PNG, 0 is unknown; in the others, NaN, infinity, 0 and below.
        scale: PNG levels per meter. By default what the file says, as `write_depth`'s do (1000), else KITTI's 256.

    Returns:
        float32 [H, W], NaN where unknown.

    Raises:
        AnyNetError: if the file is missing, damaged, or does not hold one depth map.
    """
    if scale is None and Path(path).suffix.lower() == ".png":
        text = open_image(path).info.get(_SCALE, "")
        scale = float(text) if isinstance(text, str) and re.fullmatch("[1-9][0-9]{0,5}", text) else None
    depth = read_disparity(path, scale)
    depth[~(depth > 0)] = np.nan
    return depth


def write_depth(path: str | Path, depth: npt.NDArray[np.float32]) -> None:
    """Writes a depth map [H, W], meters, NaN where unknown, in the format that the name's ending says, atomically.

    .tiff and .npy hold 32-bit floating-point meters, NaN where unknown; .png 16-bit millimeters, 0 where unknown or
    beyond its 65.535 m, with a warning.

    Raises:
        AnyNetError: if the name has another ending, it is no such map, or the file cannot be written.
    """
    depth = as_map(path, depth)
    suffix = Path(path).suffix.lower()
    buffer = io.BytesIO()
    if suffix in (".tiff", ".tif"):
        Image.fromarray(depth).save(buffer, format="TIFF")
    elif suffix == ".npy":
        np.save(buffer, depth)
    elif suffix == ".png":
        levels = millimeters(depth)
        far = int(np.count_nonzero((depth > 0) & (levels == 0)))
        if far:
            warnings.warn(f"{path}: {far} pixels are farther than 65.535 m, and so unknown in this PNG", stacklevel=2)
        chunk = PngImagePlugin.PngInfo()
        chunk.add_text(_SCALE, str(_MILLIMETERS))
        Image.fromarray(levels).save(buffer, format="PNG", pnginfo=chunk)
    else:
        raise AnyNetError(f"{path}: expected a name of a depth map ending in .tiff, .npy or .png")
    write_atomically(path, buffer.getvalue())


def millimeters(depth: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
    """Depth in meters, NaN where unknown, as whole millimeters from 1 on, 0 where unknown or beyond 65.535 m."""
    levels = np.round(np.where(depth > 0, depth, 0) * np.float64(_MILLIMETERS))
    return np.where((depth > 0) & (levels <= 65535), levels.clip(min=1), 0).astype(np.uint16)
