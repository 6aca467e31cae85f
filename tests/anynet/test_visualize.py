from __future__ import annotations

import numpy as np
import pytest

from anynet.errors import AnyNetError
from anynet.visualize import UNKNOWN, colorbar, colorize, disparity_image, error_image, limits_of, panels, stages_image

RAMP = np.linspace(0, 100, 200, dtype=np.float32)[None].repeat(120, 0)


def test_colors_follow_the_scale() -> None:
    colors = colorize(np.array([[-5, 0, 50, 100, 300]], np.float32), (0, 100))[0].astype(int)
    np.testing.assert_array_equal(colors[0], colors[1])  # beyond the limits: their colors
    np.testing.assert_array_equal(colors[3], colors[4])
    near, far = colors[3], colors[1]
    assert near[0] > near[2]  # red
    assert far[2] > far[0]  # blue
    assert len(np.unique(colorize(RAMP, (0, 100))[0], axis=0)) > 190


@pytest.mark.parametrize("colormap", ["turbo", "blue-red"])
def test_unknown_is_no_color_of_the_scale(colormap: str) -> None:
    values = np.array([[np.nan, np.inf, -np.inf]], np.float32)
    np.testing.assert_array_equal(colorize(values, (0, 1), colormap)[0], [UNKNOWN] * 3)
    distance = np.abs(colorize(RAMP, (0, 100), colormap).astype(int) - UNKNOWN).max(axis=-1)
    assert distance.min() > 50


def test_colors_that_cannot_be() -> None:
    with pytest.raises(AnyNetError, match="expected limits of which the first is lower, got 5 and 5"):
        colorize(RAMP, (5, 5))
    with pytest.raises(AnyNetError, match="expected colormap 'turbo' or 'blue-red', got 'viridis'"):
        colorize(RAMP, (0, 1), "viridis")


def test_limits() -> None:
    low, high = limits_of(np.append(RAMP, [np.nan, np.inf, 1e6]).astype(np.float32))
    assert 0 < low < 2
    assert 98 < high < 100
    assert limits_of(np.full((3, 3), np.nan, np.float32)) == (0, 1)
    low, high = limits_of(np.full((3, 3), 7, np.float32))
    assert low == 7 < high


def test_image_is_the_map_and_its_colorbar() -> None:
    image = disparity_image(RAMP, (0, 100))
    strip = colorbar(len(RAMP), (0, 100), "px", "turbo")
    np.testing.assert_array_equal(image, np.hstack([colorize(RAMP, (0, 100)), strip]))
    shown = {tuple(pixel) for pixel in strip.reshape(-1, 3).tolist()}
    assert {tuple(c) for c in colorize(RAMP, (0, 100))[0, [0, -1]].tolist()} <= shown  # both ends of the scale
    assert UNKNOWN in shown


@pytest.mark.parametrize("size", [(1, 1), (5, 7), (60, 1), (1, 900)])
def test_images_of_any_size(size: tuple[int, int]) -> None:
    for values in (np.zeros(size, np.float32), np.full(size, np.nan, np.float32)):
        image = disparity_image(values)
        assert image.dtype == np.uint8
        assert image.shape[0] == size[0]
        assert image.shape[1] > size[1]


def test_error_image() -> None:
    truth = np.array([[10, 10, 10, np.nan]], np.float32).repeat(100, 0)
    image = error_image(truth + np.array([0, 2, -9, 0], np.float32), truth)[0, :4].astype(int)
    assert image[0, 2] > image[0, 0]  # right: blue
    assert image[2, 0] > image[2, 2]  # 9 px off: red
    np.testing.assert_array_equal(image[3], UNKNOWN)


def test_panels_hold_every_image() -> None:
    images = [(str(value), np.full((20 + value, 30 + 10 * (value % 3), 3), value, np.uint8)) for value in (40, 80, 120)]
    canvas = panels(images)
    for _, image in images:
        assert (canvas == image[0, 0]).all(axis=-1).sum() >= image[..., 0].size


def test_stages_image() -> None:
    left = np.zeros((*RAMP.shape, 3), np.uint8)
    stages = [("stage 1", RAMP + 2), ("stage 2", RAMP)]
    alone, with_truth = stages_image(left, stages), stages_image(left, stages, RAMP)
    assert with_truth.shape[0] > 1.4 * alone.shape[0]  # three rows of panels, not two
