from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from anynet.errors import AnyNetError
from anynet.io import read_depth, write_depth, write_disparity

DEPTH = np.array([[0.5, 2.6804, np.nan], [65.535, 70, 0.0001]], np.float32)


@pytest.mark.parametrize("ending", [".tiff", ".npy"])
def test_meters_come_back(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"depth{ending}"
    write_depth(path, DEPTH)
    np.testing.assert_array_equal(read_depth(path), DEPTH)


def test_millimeters(tmp_path: Path) -> None:
    path = tmp_path / "depth.png"
    with pytest.warns(UserWarning, match=r"1 pixels are farther than 65\.535 m"):
        write_depth(path, DEPTH)
    levels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert levels.dtype == np.uint16
    np.testing.assert_array_equal(levels, [[500, 2680, 0], [65535, 0, 1]])
    expected = np.array([[0.5, 2.68, np.nan], [65.535, np.nan, 0.001]])
    np.testing.assert_allclose(read_depth(path), expected, rtol=1e-6)  # our own file says what its levels are


def test_the_levels_of_other_pngs(tmp_path: Path) -> None:
    path = tmp_path / "depth.png"
    Image.fromarray(np.array([[0, 512]], np.uint16)).save(path)
    np.testing.assert_array_equal(read_depth(path), [[np.nan, 2]])
    np.testing.assert_allclose(read_depth(path, scale=1000), [[np.nan, 0.512]], rtol=1e-6)


def test_what_is_not_in_front_is_unknown(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", np.array([[0, 3]], np.float32))
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.npy"), [[np.nan, 3]])


def test_other_endings(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"ending in \.tiff, \.npy or \.png"):
        write_depth(tmp_path / "depth.jpg", DEPTH)


@pytest.mark.parametrize("levels", ["9" * 5000, "0", "-1", "nan", "\u0661", ""])
def test_levels_that_cannot_be(tmp_path: Path, levels: str) -> None:
    text = PngInfo()
    text.add_itxt("LevelsPerMeter", levels)
    Image.fromarray(np.full((2, 3), 512, np.uint16)).save(tmp_path / "depth.png", pnginfo=text)
    assert (read_depth(tmp_path / "depth.png") == 2).all()  # KITTI's, as if nothing were said


@pytest.mark.parametrize("name", ["map.pfm", "map.npy", "map.png", "map.tiff"])
def test_what_is_no_map_is_not_written(tmp_path: Path, name: str) -> None:
    writers = [write_disparity] * (name != "map.tiff") + [write_depth] * (name != "map.pfm")
    for write in writers:
        for values in (np.zeros((2, 3, 2)), np.zeros(3), np.zeros((0, 3)), np.full((2, 3), "a"), None):
            with pytest.raises(AnyNetError, match=r"expected a map of numbers \[H, W\], got"):
                write(tmp_path / name, values)
        write(tmp_path / name, torch.ones(2, 3))
