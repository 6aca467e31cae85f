"""Images, through Pillow: unlike OpenCV it refuses a truncated file and tells grey, alpha and 16-bit images apart."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from anynet.errors import AnyNetError
from anynet.io.files import read_bytes, write_atomically


def open_image(path: str | Path) -> Image.Image:
    """The decoded image as Pillow has it.

    Raises:
        AnyNetError: if the file is missing, truncated or not an image.
    """
    data = read_bytes(path)
    try:
        image = Image.open(io.BytesIO(data))
        image.load()
    except UnidentifiedImageError as error:
        raise AnyNetError(f"cannot read {path}: not an image of a known format") from error
    except Exception as error:  # a damaged file raises whatever its decoder meets first
        raise AnyNetError(f"cannot read {path}: damaged image ({error})") from error
    return image


def read_image(path: str | Path) -> npt.NDArray[np.uint8]:
    """Reads an image as 8-bit RGB, uint8 [H, W, 3].

    Grey images are repeated over the three channels. 16-bit values are scaled so that 65535 becomes 255, the same for
    every image, so that both images of a pair stay alike. An alpha channel is dropped with a warning.

    Raises:
        AnyNetError: if the file is missing, damaged, not an image, or of another type (floating point, 32-bit).
    """
    image = open_image(path)
    if image.mode.startswith("I;16"):
        grey = np.round(np.asarray(image) / 257).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2)
    if image.mode in ("I", "F"):
        raise AnyNetError(f"{path}: expected an image of 8 or 16 bits per channel, got 32 bits (mode {image.mode})")
    if image.mode in ("LA", "La", "PA", "RGBA", "RGBa"):
        warnings.warn(f"{path}: the alpha channel is ignored", stacklevel=2)
    return np.array(image.convert("RGB"))


def read_pair(left: str | Path, right: str | Path) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Reads the two images of a pair, as `read_image` does.

    Raises:
        AnyNetError: if one of them cannot be read, or they differ in size.
    """
    images = read_image(left), read_image(right)
    if images[0].shape != images[1].shape:
        sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in images)
        raise AnyNetError(f"expected two images of one size, got {sizes} ({left}, {right})")
    return images


def write_image(path: str | Path, image: npt.NDArray[np.uint8]) -> None:
    """Writes uint8 [H, W, 3] RGB in the format that the name's ending says, atomically.

    Raises:
        AnyNetError: if the name has no known ending, or the file cannot be written.
    """
    image_format = Image.registered_extensions().get(Path(path).suffix.lower())
    if image_format is None:
        raise AnyNetError(f"{path}: expected a name ending like an image format, such as .png")
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format=image_format)
    write_atomically(path, buffer.getvalue())
