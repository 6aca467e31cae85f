"""Disparity and depth maps. In memory: float32 [H, W], NaN where unknown."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from anynet.errors import AnyNetError
from anynet.io.files import read_bytes, write_atomically
from anynet.io.images import open_image

KITTI_SCALE = 256  # PNG levels per pixel of disparity


def read_disparity(path: str | Path, scale: float | None = None) -> npt.NDArray[np.float32]:
    """Reads a disparity map, pixels, from PNG, PFM, NPY or NPZ.

    Args:
        path: the file. A PNG has one channel and 0 where unknown; the other formats have NaN or infinity there.
        scale: PNG levels per pixel of disparity; KITTI's 256 if not given, and then 16 bits are expected.

    Returns:
        float32 [H, W], NaN where unknown.

    Raises:
        AnyNetError: if the file is missing, damaged, or does not hold one disparity map.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".png":
        disparity = _read_png(path, scale)
    elif suffix == ".pfm":
        disparity = _read_pfm(path)
    elif suffix in (".npy", ".npz"):
        disparity = _read_numpy(path)
    else:
        raise AnyNetError(f"{path}: expected a disparity map in a .png, .pfm, .npy or .npz file")
    disparity[~np.isfinite(disparity)] = np.nan
    return disparity


def write_disparity(path: str | Path, disparity: npt.NDArray[np.float32]) -> None:
    """Writes a disparity map [H, W], pixels, in the format that the name's ending says, atomically.

    .png is KITTI's: 16 bits, 256 levels per pixel, 0 where unknown; a known disparity below 1/256 is written as 1/256.
    .pfm has infinity where unknown, as Middlebury and ETH3D do; .npy has NaN.

    Raises:
        AnyNetError: if a disparity does not fit into the format, or the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".png":
        data = _encode_png(path, disparity)
    elif suffix == ".pfm":
        header = f"Pf\n{disparity.shape[1]} {disparity.shape[0]}\n-1.0\n"  # negative: little-endian
        known = np.where(np.isnan(disparity), np.inf, disparity)
        data = header.encode() + known[::-1].astype("<f4").tobytes()
    elif suffix == ".npy":
        buffer = io.BytesIO()
        np.save(buffer, disparity.astype(np.float32))
        data = buffer.getvalue()
    else:
        raise AnyNetError(f"{path}: expected a name ending in .png, .pfm or .npy")
    write_atomically(path, data)


def _read_png(path: str | Path, scale: float | None) -> npt.NDArray[np.float32]:
    image = open_image(path)
    if image.mode == "L" and scale is None:
        raise AnyNetError(f"{path}: expected KITTI's 16 bits per pixel, got 8 bits, whose scale is not known")
    if image.mode != "L" and not image.mode.startswith("I"):
        raise AnyNetError(f"{path}: expected one channel of disparity, got an image of mode {image.mode}")
    levels = np.asarray(image).astype(np.float32)
    return np.where(levels > 0, levels / np.float32(scale or KITTI_SCALE), np.float32(np.nan))


def _encode_png(path: str | Path, disparity: npt.NDArray[np.float32]) -> bytes:
    known = ~np.isnan(disparity)
    levels = np.round(np.where(known, disparity, 0) * np.float64(KITTI_SCALE))
    if (levels > 65535).any():
        raise AnyNetError(
            f"{path}: a 16-bit PNG holds disparities below 256 pixels, got {np.nanmax(disparity):.1f}; use pfm or npy"
        )
    buffer = io.BytesIO()
    Image.fromarray(np.where(known, levels.clip(min=1), 0).astype(np.uint16)).save(buffer, format="PNG")
    return buffer.getvalue()


def _read_pfm(path: str | Path) -> npt.NDArray[np.float32]:
    """The header's scale tells the byte order by its sign; its magnitude is a unit of brightness, not of disparity."""
    parts = read_bytes(path).split(
        None, 3
    )  # magic, width, height, rest: the samples may start with a byte like a blank
    try:
        magic, width, height = parts[0], int(parts[1]), int(parts[2])
        scale, samples = parts[3].split(b"\n", 1)
        little = float(scale) < 0
    except (IndexError, ValueError) as error:
        raise AnyNetError(f"{path}: not a PFM file") from error
    if magic != b"Pf":
        raise AnyNetError(
            f"{path}: expected a PFM file of one channel (Pf), got {magic.decode(errors='replace')[:8]!r}"
        )
    if len(samples) != 4 * width * height:
        raise AnyNetError(
            f"{path}: expected {4 * width * height} bytes for {width} x {height} pixels, got {len(samples)}"
        )
    values = np.frombuffer(samples, "<f4" if little else ">f4").reshape(height, width)
    return values[::-1].astype(np.float32)  # rows are stored from the bottom up


def _read_numpy(path: str | Path) -> npt.NDArray[np.float32]:
    try:
        loaded = np.load(io.BytesIO(read_bytes(path)), allow_pickle=False)
        arrays = {"": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise AnyNetError(f"{path}: not a NumPy file of plain numbers ({error})") from error
    if len(arrays) != 1:
        raise AnyNetError(f"{path}: expected one array, got {sorted(arrays)}")
    (array,) = arrays.values()
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise AnyNetError(f"{path}: expected numbers of shape [H, W], got {array.dtype} {list(array.shape)}")
    return np.array(array, dtype=np.float32)
