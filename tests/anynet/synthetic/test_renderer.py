"""Rendered pairs: exact disparities, honest occlusion masks, repeatable."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from anynet.samples import RenderedSample
from anynet.synthetic import PRESETS, render


def seen_through(image: np.ndarray, disparity: np.ndarray, sign: int) -> np.ndarray:
    """`image` of one view sampled where the other view's pixels lie in it, linearly."""
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in disparity.shape[::-1]))
    return cv2.remap(image, x + sign * disparity, y, cv2.INTER_LINEAR)


def smooth(disparity: np.ndarray, limit: float = 1.0) -> np.ndarray:
    """Where disparity varies by less than `limit` pixels in a 5 x 5 neighborhood: away from edges."""
    return cv2.morphologyEx(disparity, cv2.MORPH_GRADIENT, np.ones((5, 5))) < limit


def interpolation_error(image: np.ndarray, disparity: np.ndarray, sign: int) -> np.ndarray:
    """By how much `seen_through` may be wrong on a curve: an eighth of the second difference around it."""
    bend = np.abs(cv2.filter2D(image, -1, np.array([[1.0, -2.0, 1.0]])))
    return seen_through(cv2.dilate(bend, np.ones((1, 3))), disparity, sign) / 8


@pytest.fixture(scope="module", params=sorted(PRESETS))
def sample(request: pytest.FixtureRequest) -> RenderedSample:
    return render(3, 192, 384, preset=request.param, sensor=False)


@pytest.mark.parametrize("view", ["left", "right"])
def test_disparities_of_the_two_views_agree(sample: RenderedSample, view: str) -> None:
    if view == "left":
        mine, other, occluded, sign = sample.disparity, sample.right_disparity, sample.occluded, -1
    else:
        mine, other, occluded, sign = sample.right_disparity, sample.disparity, sample.right_occluded, 1
    inside = ~occluded & smooth(mine) & (seen_through(smooth(other).astype(np.float32), mine, sign) > 0.99)
    assert inside.mean() > 0.3
    error = np.abs(seen_through(other, mine, sign) - mine)[inside]
    assert np.median(error) < 1e-3  # planes are exact; on curves `other` is interpolated
    assert np.percentile(error - interpolation_error(other, mine, sign)[inside], 99) < 0.05
    assert error.mean() < 0.02


def test_right_view_warped_by_the_disparity_is_the_left_view(sample: RenderedSample) -> None:
    warped = seen_through(sample.right, sample.disparity, -1)
    difference = np.abs(warped.astype(np.float32) - sample.left).mean(2)
    matched = ~sample.occluded & smooth(sample.disparity)
    unmatched = np.abs(np.roll(warped, 4, 1).astype(np.float32) - sample.left).mean(2)
    assert difference[matched].mean() < 0.5 * unmatched[matched].mean()
    assert np.median(difference[matched]) < 5


def test_occluded_pixels_are_hidden_by_something_nearer_or_out_of_view(sample: RenderedSample) -> None:
    columns = np.arange(sample.disparity.shape[1]) - sample.disparity
    there = seen_through(sample.right_disparity, sample.disparity, -1)
    hidden = sample.occluded & (columns >= 0)
    assert (there[hidden] > sample.disparity[hidden]).mean() > 0.9
    assert (sample.occluded == ~sample.noc).all()


def test_same_seed_same_pair() -> None:
    a, b, c = (render(seed, 128, 192) for seed in (5, 5, 6))
    assert all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ("left", "right", "disparity", "right_disparity"))
    assert not np.array_equal(a.left, c.left)


def test_disparities_span_the_range_that_scenes_promise() -> None:
    street = [render(seed, 192, 384, preset="street").disparity for seed in range(4)]
    assert all(d.min() >= 0 for d in street)
    assert min(d.min() for d in street) < 1  # sky
    things = [render(seed, 384, 768, preset="things").disparity.max() for seed in range(6)]
    assert max(things) > 90


def test_sensor_changes_the_images_but_not_the_truth() -> None:
    clean, taken = (render(2, 128, 192, sensor=sensor) for sensor in (False, True))
    assert np.array_equal(clean.disparity, taken.disparity)
    assert not np.array_equal(clean.left, taken.left)


def test_wrong_arguments() -> None:
    with pytest.raises(ValueError, match=r"unknown preset \['moon'\]"):
        render(0, preset="moon")
    with pytest.raises(ValueError, match="at least 64 x 64 pixels, got 32 x 64"):
        render(0, 32, 64)
