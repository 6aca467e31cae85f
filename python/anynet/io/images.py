"""Images, through Pillow: unlike OpenCV it refuses a truncated file and tells gray, alpha and 16-bit images apart."""

from __future__ import annotations

import io
import re
import sys
import warnings
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import ExifTags, Image, ImageFile, UnidentifiedImageError

from anynet.errors import AnyNetError, one_line
from anynet.io.files import check_size, max_pixels, read_bytes, telling_damage, write_atomically

# Those that cameras and data sets use, without those that Pillow hands to other programs (EPS); and their modules of
# Pillow, as importing all of its fifty formats takes long.
FORMATS = ("PNG", "JPEG", "TIFF", "PPM", "BMP", "WEBP", "GIF", "JPEG2000", "TGA", "AVIF")
_PLUGINS = ("Png", "Jpeg", "Tiff", "Ppm", "Bmp", "WebP", "Gif", "Jpeg2K", "Tga", "Avif")
_SCANS = 10  # of a JPEG of most pixels: each costs as much as decoding them all
_DEFLATED = 1032  # most bytes that one byte of a PNG tells
_BINARY = "binary values up to 255 or 65535 in a PPM or PGM"
# Pillow's decoders in Python: the most pixels that they are trusted with, and what is faster.
_SLOW = {"ppm": (2**20, _BINARY), "ppm_plain": (2**20, _BINARY), "bmp_rle": (2**23, "no compression in a BMP")}
_COLUMNS = 2**20  # most, as OpenCV's: Pillow copies what it has of a row with every block that it reads

# What EXIF's orientation says to do with the stored pixels.
_UPRIGHT = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
_BITS_PER_SAMPLE, _PLANAR_CONFIGURATION = 258, 284  # tags of a TIFF
_DEEP_COLOR = re.compile("RGBA?;16[BLN]$")
Levels = npt.NDArray[Any]  # uint8 or uint16


@cache
def _formats() -> dict[str, str]:
    """Loads what `FORMATS` needs, as far as this Pillow has it. Returns the format of each ending of file names."""
    for name in _PLUGINS:
        with suppress(ImportError):
            import_module(f"PIL.{name}ImagePlugin")
    return Image.EXTENSION


def endings() -> set[str]:
    """The endings of file names that images have, such as .png."""
    return {ending for ending, kind in _formats().items() if kind in FORMATS}


def open_image(path: str | Path) -> Image.Image:
    """The decoded image as Pillow has it, turned as its EXIF orientation says; of an animation the first frame.

    Raises:
        AnyNetError: if the file is missing, truncated or not an image, or has more than `max_pixels`.
    """
    return _upright(path, _open(path, read_bytes(path)))


def image_size(path: str | Path) -> tuple[int, int]:
    """Width and height as stored, without decoding the pixels.

    Raises:
        AnyNetError: as `open_image`.
    """
    return _open(path, read_bytes(path)).size


def read_image(path: str | Path, bits: int | None = None) -> npt.NDArray[np.uint8]:
    """Reads an image as 8-bit RGB, uint8 [H, W, 3], upright as its EXIF orientation says.

    Gray images are repeated over the three channels. An alpha channel is dropped with a warning.

    Args:
        path: the file.
        bits: how many of an image's 16 bits are used: 2**bits - 1 becomes 255. By default 16, with a warning if the
            image uses fewer. Both images of a pair need the same; `read_pair` finds it.

    Raises:
        AnyNetError: if the file is missing, damaged, not an image, or of another type (floating point, 32-bit), or has
            more than `max_pixels`.
    """
    levels = read_levels(path)
    if bits is None:
        bits = 16
        used = used_bits(levels)
        if levels.dtype == np.uint16 and used < bits:
            warnings.warn(f"{path}: uses {used} of its 16 bits and so is dark; see `bits`", stacklevel=2)
    elif not 8 <= bits <= 16:
        raise AnyNetError(f"expected bits from 8 to 16, got {bits}")
    return to_8_bits(levels, bits)


def read_pair(left: str | Path, right: str | Path) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Reads the two images of a pair, as `read_image` does.

    Images of 16 bits are scaled alike, by the bits that the brighter one uses: 8, 10, 12, 14 or 16.

    Raises:
        AnyNetError: if one of them cannot be read, or they differ in size.
    """
    images = read_levels(left), read_levels(right)
    if images[0].shape[:2] != images[1].shape[:2]:
        sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in images)
        raise AnyNetError(f"expected two images of one size, got {sizes} ({left}, {right})")
    bits = max(used_bits(image) for image in images)
    return to_8_bits(images[0], bits), to_8_bits(images[1], bits)


def write_image(path: str | Path, image: npt.NDArray[np.uint8]) -> None:
    """Writes uint8 [H, W, 3] RGB in the format that the name's ending says, atomically.

    Raises:
        AnyNetError: if the name has no known ending, or the file cannot be written.
    """
    image_format = _formats().get(Path(path).suffix.lower())
    if image_format not in FORMATS:
        raise AnyNetError(f"{path}: expected a name ending like an image format, such as .png")
    buffer = io.BytesIO()
    try:
        Image.fromarray(image).save(buffer, format=image_format)
    except Exception as error:  # such as a size that the format does not hold
        raise AnyNetError(f"cannot write {path}: {one_line(error)}") from error
    write_atomically(path, buffer.getvalue())


def _open(path: str | Path, data: bytes) -> ImageFile.ImageFile:
    """The image with its header read and its size checked."""
    _formats()
    if Image.MAX_IMAGE_PIXELS is not None and max_pixels() > Image.MAX_IMAGE_PIXELS:
        Image.MAX_IMAGE_PIXELS = max_pixels()  # the user has raised the limit, so Pillow's must follow
    with telling_damage(path, "damaged image"):
        try:
            image = Image.open(io.BytesIO(data), formats=[kind for kind in FORMATS if kind in Image.OPEN])
        except UnidentifiedImageError:
            raise AnyNetError(f"cannot read {path}: not an image of a known format") from None
        except Image.DecompressionBombError as error:
            raise AnyNetError(f"{path}: expected at most {max_pixels()} pixels; {one_line(error)}") from None
        check_size(path, *image.size)
    if image.width > _COLUMNS:
        raise AnyNetError(f"{path}: expected at most {_COLUMNS} columns, got {image.width} x {image.height} pixels")
    pixels = image.width * image.height
    if image.format == "PNG" and _DEFLATED * len(data) < image.height * (image.width * _png_bits(data) // 8):
        raise AnyNetError(f"{path}: expected more than {len(data)} bytes for {image.width} x {image.height} pixels")
    if image.format in ("JPEG", "MPO") and data.count(b"\xff\xda") * pixels > _SCANS * max_pixels():
        raise AnyNetError(f"{path}: expected a JPEG of {image.width} x {image.height} pixels to have fewer scans")
    return image


def _png_bits(data: bytes) -> int:
    """Bits of a PNG's pixel, as its header has them."""
    return data[24] * {2: 3, 4: 2, 6: 4}.get(data[25], 1)


def _upright(path: str | Path, image: ImageFile.ImageFile) -> Image.Image:
    """The image decoded and turned."""
    slow = _SLOW.get(image.tile[0].codec_name) if image.tile else None
    if slow is not None and image.width * image.height > slow[0]:
        raise AnyNetError(f"{path}: expected {slow[1]} of this size")
    with telling_damage(path, "damaged image"):
        image.load()
        orientation = _orientation(image)  # a PNG may tell it behind the pixels; Pillow has turned a TIFF already
        return image.transpose(_UPRIGHT[orientation]) if orientation in _UPRIGHT else image


def _orientation(image: Image.Image) -> int:
    try:
        orientation = image.getexif().get(ExifTags.Base.Orientation, 1)
    except Exception:  # damaged metadata: viewers show the image as it is stored
        return 1
    return orientation if isinstance(orientation, int) else 1


def read_levels(path: str | Path) -> Levels:
    """The levels of an image file, as `decode_levels` of its bytes."""
    return decode_levels(path, read_bytes(path))


def decode_levels(path: str | Path, data: bytes) -> Levels:
    """The levels of an image file's bytes, uint8 or uint16, gray [H, W] or RGB [H, W, 3], upright.

    Args:
        path: what errors call it.
        data: the file's content.

    Raises:
        AnyNetError: as `read_image`.
    """
    stored = _open(path, data)
    if stored.format == "PPM" and data[:2] in (b"P5", b"P6"):
        return _ppm_levels(path, data, stored)
    _check_deep(path, stored)
    deep_color = bool(stored.tile) and all(_DEEP_COLOR.match(_raw_mode(tile.args)) for tile in stored.tile)
    image = _upright(path, stored)
    if image.mode in ("LA", "La", "PA", "RGBA", "RGBa"):
        warnings.warn(f"{path}: the alpha channel is ignored", stacklevel=3)
    with telling_damage(path, "damaged image"):
        if image.mode.startswith("I;16") or (image.mode == "I" and stored.format == "PNG"):
            return np.asarray(image).astype(np.uint16)
        if image.mode in ("I", "F"):
            raise AnyNetError(f"{path}: expected an image of 8 or 16 bits per channel, got 32 bits (mode {image.mode})")
        rgb = np.array(image.convert("RGB"))
        return rgb.astype(np.uint16) << 8 | _lower_bytes(path, data) if deep_color else rgb


def _check_deep(path: str | Path, image: ImageFile.ImageFile) -> None:
    """Raises AnyNetError where Pillow would take 16 bits of a level for 8."""
    if any(_raw_mode(tile.args) == "LA;16B" for tile in image.tile):
        raise AnyNetError(f"{path}: expected 16-bit gray without an alpha channel")
    tags = getattr(image, "tag_v2", {})
    if tags.get(_PLANAR_CONFIGURATION) == 2 and max(tags.get(_BITS_PER_SAMPLE, (8,))) > 8:
        raise AnyNetError(f"{path}: expected 16-bit colors pixel by pixel, not plane by plane")


def _lower_bytes(path: str | Path, data: bytes) -> Levels:
    """Those of 16-bit colors, RGB [H, W, 3] upright: Pillow reads the upper bytes only, so the order is exchanged."""
    image = _open(path, data)
    image.tile = [tile._replace(args=_exchanged(tile.args)) for tile in image.tile]
    return np.asarray(_upright(path, image).convert("RGB"))


def _raw_mode(args: Any) -> str:
    return str(args[0] if isinstance(args, tuple) and args else args)


def _exchanged(args: Any) -> Any:
    if isinstance(args, tuple):
        return (_exchanged(args[0]), *args[1:])
    mode, order = str(args).split(";16")
    native = "L" if sys.byteorder == "little" else "B"
    return f"{mode};16{'B' if (native if order == 'N' else order) == 'L' else 'L'}"


def _ppm_levels(path: str | Path, data: bytes, image: ImageFile.ImageFile) -> Levels:
    """Of binary PPM and PGM: Pillow decodes maxima other than 255 and 65535 slowly, and colors to 8 bits."""
    args, offset = image.tile[0].args, image.tile[0].offset
    maximum = int(args[-1]) if isinstance(args, tuple) else 65535 if args == "I;16B" else 255
    stored, full = (np.dtype(np.uint8), 255) if maximum < 256 else (np.dtype(">u2"), 65535)
    shape = (image.height, image.width, 3)[: 2 if data[:2] == b"P5" else 3]
    needed = int(np.prod(shape, dtype=np.int64)) * stored.itemsize
    if len(data) - offset < needed:
        raise AnyNetError(f"cannot read {path}: expected {needed} bytes of pixels, got {max(0, len(data) - offset)}")
    levels: npt.NDArray[Any] = np.frombuffer(data, stored, needed // stored.itemsize, offset).reshape(shape)
    if maximum == full:
        return levels.astype(stored.newbyteorder("="))
    table = np.round(np.arange(full + 1) * (full / maximum)).clip(max=full)
    return _looked_up(levels, table.astype(stored.newbyteorder("=")))


def used_bits(levels: Levels) -> int:
    """How many bits the levels use, among those that sensors have."""
    return max(8, 2 * ((int(levels.max()).bit_length() + 1) // 2))


def to_8_bits(levels: Levels, bits: int) -> npt.NDArray[np.uint8]:
    """RGB [H, W, 3]; a level of 16 bits is scaled so that 2**bits - 1 becomes 255."""
    result: npt.NDArray[Any] = levels
    if levels.dtype == np.uint16:
        table = np.round(np.arange(2**16) * (255 / (2**bits - 1))).clip(max=255).astype(np.uint8)
        result = _looked_up(levels, table)
    return np.repeat(result[..., None], 3, axis=2) if result.ndim == 2 else result


def _looked_up(levels: npt.NDArray[Any], table: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """table[levels], part by part: NumPy takes 8 bytes per index."""
    found = np.empty(levels.size, table.dtype)
    for start in range(0, levels.size, 2**20):
        part = slice(start, start + 2**20)
        found[part] = table[levels.reshape(-1)[part]]
    return found.reshape(levels.shape)


def check_pair(left: Any, right: Any, where: str = "") -> None:
    """Raises AnyNetError unless they are uint8 RGB arrays [H, W, 3] of one size; `where` begins the message."""
    for name, image in (("left", left), ("right", right)):
        known = isinstance(image, np.ndarray)
        if not known or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or not image.size:
            got = f"{image.dtype} {list(image.shape)}" if known else type(image).__name__
            raise AnyNetError(f"{where}expected {name} as uint8 RGB array [H, W, 3], got {got}")
    if left.shape != right.shape:
        sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in (left, right))
        raise AnyNetError(f"{where}expected two images of one size, got {sizes}")
