from __future__ import annotations

import numpy as np
import pytest

from anynet.visualize import UNKNOWN, colour, error_picture, legend, limits_of, panels, picture_of, stages_picture

RAMP = np.linspace(0, 100, 200, dtype=np.float32)[None].repeat(120, 0)


def test_colours_follow_the_scale() -> None:
    colours = colour(np.array([[-5, 0, 50, 100, 300]], np.float32), (0, 100))[0].astype(int)
    np.testing.assert_array_equal(colours[0], colours[1])  # beyond the limits: their colours
    np.testing.assert_array_equal(colours[3], colours[4])
    near, far = colours[3], colours[1]
    assert near[0] > near[2]  # red
    assert far[2] > far[0]  # blue
    assert len(np.unique(colour(RAMP, (0, 100))[0], axis=0)) > 190


@pytest.mark.parametrize("scale", ["turbo", "errors"])
def test_unknown_is_no_colour_of_the_scale(scale: str) -> None:
    values = np.array([[np.nan, np.inf, -np.inf]], np.float32)
    np.testing.assert_array_equal(colour(values, (0, 1), scale)[0], [UNKNOWN] * 3)
    distance = np.abs(colour(RAMP, (0, 100), scale).astype(int) - UNKNOWN).max(axis=-1)
    assert distance.min() > 50


def test_limits() -> None:
    low, high = limits_of(np.append(RAMP, [np.nan, np.inf, 1e6]).astype(np.float32))
    assert 0 < low < 2
    assert 98 < high < 100
    assert limits_of(np.full((3, 3), np.nan, np.float32)) == (0, 1)
    low, high = limits_of(np.full((3, 3), 7, np.float32))
    assert low == 7 < high


def test_picture_is_the_map_and_its_legend() -> None:
    picture = picture_of(RAMP, (0, 100))
    strip = legend(len(RAMP), (0, 100), "px", "turbo")
    np.testing.assert_array_equal(picture, np.hstack([colour(RAMP, (0, 100)), strip]))
    shown = {tuple(pixel) for pixel in strip.reshape(-1, 3).tolist()}
    assert {tuple(c) for c in colour(RAMP, (0, 100))[0, [0, -1]].tolist()} <= shown  # both ends of the scale
    assert UNKNOWN in shown


@pytest.mark.parametrize("size", [(1, 1), (5, 7), (60, 1), (1, 900)])
def test_pictures_of_any_size(size: tuple[int, int]) -> None:
    for values in (np.zeros(size, np.float32), np.full(size, np.nan, np.float32)):
        picture = picture_of(values)
        assert picture.dtype == np.uint8
        assert picture.shape[0] == size[0]
        assert picture.shape[1] > size[1]


def test_error_picture() -> None:
    truth = np.array([[10, 10, 10, np.nan]], np.float32).repeat(100, 0)
    picture = error_picture(truth + np.array([0, 2, -9, 0], np.float32), truth)[0, :4].astype(int)
    assert picture[0, 2] > picture[0, 0]  # right: blue
    assert picture[2, 0] > picture[2, 2]  # 9 px off: red
    np.testing.assert_array_equal(picture[3], UNKNOWN)


def test_panels_hold_every_picture() -> None:
    pictures = [
        (str(value), np.full((20 + value, 30 + 10 * (value % 3), 3), value, np.uint8)) for value in (40, 80, 120)
    ]
    canvas = panels(pictures)
    for _, picture in pictures:
        assert (canvas == picture[0, 0]).all(axis=-1).sum() >= picture[..., 0].size


def test_stages_picture() -> None:
    left = np.zeros((*RAMP.shape, 3), np.uint8)
    stages = [("stage 1", RAMP + 2), ("stage 2", RAMP)]
    alone, with_truth = stages_picture(left, stages), stages_picture(left, stages, RAMP)
    assert with_truth.shape[0] > 1.4 * alone.shape[0]  # three rows of panels, not two
