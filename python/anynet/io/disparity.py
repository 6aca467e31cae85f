"""Disparity and depth maps. In memory: float32 [H, W], NaN where unknown."""

from __future__ import annotations

import io
import math
import re
import warnings
import zipfile
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt
from PIL import Image

from anynet.errors import AnyNetError, one_line
from anynet.io.files import check_size, read_bytes, telling_damage, write_atomically
from anynet.io.images import open_image

KITTI_SCALE = 256  # PNG levels per pixel of disparity
FORMATS = (".png", ".pfm", ".npy", ".npz", ".tif", ".tiff")
_LARGEST = 1e6  # pixels or meters; beyond it the file means something else, such as the other byte order
_MEMBERS = 1000  # most entries of an archive; each takes memory before it is looked at
_PFM = re.compile(
    rb"(?P<magic>P[A-Za-z0-9])(?:\s|#[^\n]*\n)+(?P<width>\d{1,10})(?:\s|#[^\n]*\n)+(?P<height>\d{1,10})"
    rb"(?:\s|#[^\n]*\n)+(?P<scale>[-+.\deE]{1,40})[ \t]*\r?\n"
)


def read_disparity(path: str | Path, scale: float | None = None) -> npt.NDArray[np.float32]:
    """Reads a disparity map, pixels, from PNG, PFM, NPY, NPZ, or a TIFF such as `write_depth` makes.

    Warns if there are negative values: AnyNet's disparities are positive.

    Args:
        path: the file. A PNG has one channel and 0 where unknown; the other formats have NaN or infinity there.
        scale: PNG levels per pixel of disparity; KITTI's 256 if not given, and then 16 bits are expected.

    Returns:
        float32 [H, W], NaN where unknown.

    Raises:
        AnyNetError: if the file is missing, damaged, or does not hold one disparity map; or has more than
            `anynet.io.files.max_pixels`, or values beyond a million.
    """
    if scale is not None and not 0 < scale < math.inf:
        raise AnyNetError(f"{path}: expected scale > 0, got {scale}")
    suffix = Path(path).suffix.lower()
    if suffix == ".png":
        disparity = _read_png(path, scale)
    elif suffix == ".pfm":
        disparity = _read_pfm(path)
    elif suffix == ".npy":
        disparity = _read_npy(path, read_bytes(path))
    elif suffix == ".npz":
        disparity = _read_npz(path)
    elif suffix in (".tif", ".tiff"):
        disparity = _read_tiff(path)
    else:
        raise AnyNetError(f"{path}: expected a disparity map in a .png, .pfm, .npy, .npz or .tiff file")
    disparity[~np.isfinite(disparity)] = np.nan
    largest = float(np.fmax.reduce(np.abs(disparity), axis=None))
    if largest > _LARGEST:
        raise AnyNetError(f"{path}: expected values up to {_LARGEST:g}, got {largest:g}")
    negative = np.count_nonzero(disparity < 0)
    if negative:
        known = np.count_nonzero(np.isfinite(disparity))
        warnings.warn(f"{path}: {negative} of {known} known values are negative", stacklevel=2)
    return disparity


def write_disparity(path: str | Path, disparity: npt.NDArray[np.float32]) -> None:
    """Writes a disparity map [H, W], pixels, in the format that the name's ending says, atomically.

    .png is KITTI's: 16 bits, 256 levels per pixel, 0 where unknown; a known disparity below 1/256 is written as 1/256.
    .pfm has infinity where unknown, as Middlebury and ETH3D do; .npy has NaN.

    Raises:
        AnyNetError: if it is no such map, a disparity does not fit into the format, or the file cannot be written.
    """
    disparity = as_map(path, disparity)
    suffix = Path(path).suffix.lower()
    if suffix == ".png":
        data = _encode_png(path, disparity)
    elif suffix == ".pfm":
        header = f"Pf\n{disparity.shape[1]} {disparity.shape[0]}\n-1.0\n"  # negative: little-endian
        known = np.where(np.isnan(disparity), np.inf, disparity)
        data = header.encode() + known[::-1].astype("<f4").tobytes()
    elif suffix == ".npy":
        buffer = io.BytesIO()
        np.save(buffer, disparity)
        data = buffer.getvalue()
    else:
        raise AnyNetError(f"{path}: expected a name ending in .png, .pfm or .npy")
    write_atomically(path, data)


def as_map(path: str | Path, values: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Values to be written to that file, as float32.

    Raises:
        AnyNetError: if they are no numbers of shape [H, W] with at least one pixel.
    """
    try:
        array = np.asarray(values)
    except Exception as error:  # a tensor's, for example, that requires gradients or is on a GPU
        raise AnyNetError(f"{path}: expected a map of numbers [H, W]; {one_line(error)}") from None
    if array.ndim != 2 or not array.size or array.dtype.kind not in "fiu":
        raise AnyNetError(f"{path}: expected a map of numbers [H, W], got {array.dtype} {list(array.shape)}")
    return array.astype(np.float32)


def _read_png(path: str | Path, scale: float | None) -> npt.NDArray[np.float32]:
    image = open_image(path)
    if image.mode == "L" and scale is None:
        raise AnyNetError(f"{path}: expected KITTI's 16 bits per pixel, got 8 bits: give the levels per pixel as scale")
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
    buffer = io.BytesIO()  # the usual level 6 takes almost three times as long, for 4 % less
    Image.fromarray(np.where(known, levels.clip(min=1), 0).astype(np.uint16)).save(
        buffer, format="PNG", compress_level=4
    )
    return buffer.getvalue()


def _read_tiff(path: str | Path) -> npt.NDArray[np.float32]:
    image = open_image(path)
    if image.mode != "F":
        raise AnyNetError(f"{path}: expected a TIFF of 32-bit floating point, got an image of mode {image.mode}")
    return np.array(image, dtype=np.float32)


def _read_pfm(path: str | Path) -> npt.NDArray[np.float32]:
    """The header's scale tells the byte order by its sign; its magnitude is a unit of brightness, not of disparity."""
    data = read_bytes(path)
    header = _PFM.match(data[:1000])
    if header is None:
        raise AnyNetError(f"{path}: not a PFM file")
    if header["magic"] != b"Pf":
        raise AnyNetError(f"{path}: expected a PFM file of one channel (Pf), got {header['magic'].decode()!r}")
    with telling_damage(path, "not a PFM file"):
        width, height, scale = int(header["width"]), int(header["height"]), float(header["scale"])
    check_size(path, width, height)
    if not 0 < abs(scale) < math.inf:
        raise AnyNetError(f"{path}: expected a scale that tells the byte order by its sign, got {scale:g}")
    pixels = width * height
    surplus = len(data) - header.end() - 4 * pixels
    if not 0 <= surplus <= 2:  # an editor or script may have ended the last line
        raise AnyNetError(
            f"{path}: expected {4 * pixels} bytes for {width} x {height} pixels, got {len(data) - header.end()}"
        )
    values = np.frombuffer(data, "<f4" if scale < 0 else ">f4", pixels, header.end()).reshape(height, width)
    return values[::-1].astype(np.float32)  # rows are stored from the bottom up


def _read_npz(path: str | Path) -> npt.NDArray[np.float32]:
    data = read_bytes(path)
    if data.count(b"PK\x01\x02") > _MEMBERS:
        raise AnyNetError(f"{path}: expected an archive of one array, got more than {_MEMBERS} members")
    with telling_damage(path, "not a NumPy file of plain numbers"), zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        if len(members) != 1:
            names = ", ".join(member.filename for member in members[:8])
            raise AnyNetError(f"{path}: expected one array, got {' '.join(names.split()) or 'none'}")
        (member,) = members
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others decode without a limit
            raise AnyNetError(f"{path}: expected an array stored or deflated as NumPy does it")
        with archive.open(member) as file:
            return _read_array(path, file, member.file_size)


def _read_npy(path: str | Path, data: bytes) -> npt.NDArray[np.float32]:
    with telling_damage(path, "not a NumPy file of plain numbers"):
        return _read_array(path, io.BytesIO(data), len(data))


def _read_array(path: str | Path, file: IO[bytes], length: int) -> npt.NDArray[np.float32]:
    """The array of an .npy file of that length, whose header is checked before memory is taken for the rest."""
    version = np.lib.format.read_magic(file)
    reading = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in reading:
        raise AnyNetError(f"{path}: expected a NumPy file of version 1 or 2, got {version[0]}.{version[1]}")
    shape, fortran, dtype = reading[version](file)
    if len(shape) != 2 or dtype.kind not in "fiu" or dtype.itemsize > 8:
        raise AnyNetError(f"{path}: expected numbers of shape [H, W], got {dtype} {list(shape)}")
    height, width = shape
    check_size(path, width, height)
    wanted = height * width * dtype.itemsize
    if length - file.tell() != wanted:
        raise AnyNetError(
            f"{path}: expected {wanted} bytes for {width} x {height} pixels, got {max(0, length - file.tell())}"
        )
    data = file.read(wanted)
    if len(data) != wanted or file.read(1):
        raise AnyNetError(f"{path}: expected {wanted} bytes for {width} x {height} pixels, got {len(data)}")
    array = np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
    with np.errstate(over="ignore"):
        return np.array(array, dtype=np.float32, order="C")
