from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from anynet.errors import AnyNetError
from anynet.io import read_image, read_pair, write_image

RGB = np.random.default_rng(0).integers(0, 256, (7, 9, 3), dtype=np.uint8)


def save(path: Path, array: np.ndarray, mode: str | None = None) -> Path:
    image = Image.fromarray(array)
    (image.convert(mode) if mode else image).save(path)
    return path


@pytest.fixture(autouse=True)
def _no_unexpected_warnings() -> None:
    warnings.simplefilter("error")


@pytest.mark.parametrize("ending", ["png", "bmp", "ppm", "tiff"])
def test_rgb_comes_back(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"image.{ending}"
    write_image(path, RGB)
    read = read_image(path)
    assert read.dtype == np.uint8
    np.testing.assert_array_equal(read, RGB)
    read[0] = 0  # not a read-only view


def test_grey_is_repeated(tmp_path: Path) -> None:
    read = read_image(save(tmp_path / "grey.png", RGB[..., 0]))
    np.testing.assert_array_equal(read, RGB[..., :1].repeat(3, 2))


def test_palette_gives_its_colours(tmp_path: Path) -> None:
    path = save(tmp_path / "palette.png", RGB // 128 * 255, "P")
    with Image.open(path) as image:
        assert image.mode == "P"
        expected = np.array(image.convert("RGB"))
    np.testing.assert_array_equal(read_image(path), expected)


@pytest.mark.parametrize("channels", [2, 4])
def test_alpha_is_dropped_with_a_warning(tmp_path: Path, channels: int) -> None:
    image = np.dstack([RGB, np.full(RGB.shape[:2], 7, np.uint8)]) if channels == 4 else RGB[..., :2].copy()
    path = save(tmp_path / "alpha.png", image)
    with pytest.warns(UserWarning, match=r"alpha\.png: the alpha channel is ignored"):
        read = read_image(path)
    np.testing.assert_array_equal(read, RGB if channels == 4 else RGB[..., :1].repeat(3, 2))


@pytest.mark.parametrize("ending", ["png", "tiff"])
def test_16_bit_grey_is_scaled(tmp_path: Path, ending: str) -> None:
    values = np.array([[0, 128, 129, 257, 32896, 65535]], np.uint16)
    read = read_image(save(tmp_path / f"deep.{ending}", values))
    np.testing.assert_array_equal(read[..., 1], [[0, 0, 1, 1, 128, 255]])


def test_16_bit_colour_is_scaled(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    path = tmp_path / "deep.png"
    cv2.imwrite(str(path), RGB[..., ::-1].astype(np.uint16) * 257)
    np.testing.assert_array_equal(read_image(path), RGB)


def test_floating_point_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "float.tiff", np.ones((3, 3), np.float32))
    with pytest.raises(AnyNetError, match="expected an image of 8 or 16 bits per channel, got 32"):
        read_image(path)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"cannot read .*none\.png: No such file"):
        read_image(tmp_path / "none.png")
    with pytest.raises(AnyNetError, match="Is a directory"):
        read_image(tmp_path)


def test_something_else_is_not_an_image(tmp_path: Path) -> None:
    path = tmp_path / "text.png"
    path.write_text("not an image")
    with pytest.raises(AnyNetError, match="not an image of a known format"):
        read_image(path)


def test_a_truncated_png_is_told_wherever_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "whole.png"
    write_image(path, RGB)
    data = path.read_bytes()
    pixels_end = data.index(b"IEND") - 12  # behind the pixels: two checksums and the empty last chunk
    for length in range(pixels_end):
        path.write_bytes(data[:length])
        with pytest.raises(AnyNetError, match=r"cannot read .*whole\.png: "):
            read_image(path)


def test_a_damaged_png_is_an_error_or_an_image(tmp_path: Path) -> None:
    """Never another exception, whatever the decoder stumbles over."""
    path = tmp_path / "damaged.png"
    write_image(path, RGB)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    errors = 0
    for _ in range(300):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        try:
            assert read_image(path).ndim == 3
        except AnyNetError:
            errors += 1
    assert errors > 250


def test_a_pair_has_one_size(tmp_path: Path) -> None:
    write_image(tmp_path / "left.png", RGB)
    write_image(tmp_path / "right.png", RGB[:, 1:])
    with pytest.raises(AnyNetError, match="expected two images of one size, got 9 x 7 and 8 x 7"):
        read_pair(tmp_path / "left.png", tmp_path / "right.png")


def test_an_unknown_ending_is_told(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="expected a name ending like an image format"):
        write_image(tmp_path / "image.xyz", RGB)
