from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from anynet import Estimate
from anynet.camera import Calibration, ShiftedPredictor, match_corners, min_disparity
from anynet.errors import AnyNetError


class Oracle:
    """A predictor of textures whose every column is of one gray: it finds the right one by its value."""

    config = "its configuration"

    def stages(self, left: np.ndarray, right: np.ndarray, **_: object) -> Iterator[Estimate]:
        assert left.shape == right.shape
        columns: dict[int, int] = {}
        for x, value in enumerate(right[0, :, 0]):
            columns.setdefault(int(value), x)  # the borders are repeated
        row = [x - columns.get(int(value), x) for x, value in enumerate(left[0, :, 0])]
        yield Estimate(1, np.tile(np.array(row, np.float32), (len(left), 1)), 1.0)

    def predict(
        self, left: np.ndarray, right: np.ndarray, budget_ms: float | None, stage: int | None, **_: object
    ) -> Estimate:
        assert (budget_ms, stage) == (5, 2)
        return next(self.stages(left, right))


def pair(disparity: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns of gray levels; left column x is right column x - disparity."""
    levels = np.arange(160, dtype=np.uint8)
    left, right = levels[30:130], levels[30 + disparity : 130 + disparity]
    return tuple(np.tile(row[None, :, None], (4, 1, 3)) for row in (left, right))  # type: ignore[return-value]


@pytest.mark.parametrize("disparity", [-12, -3, 5])
def test_negative(disparity: int) -> None:
    shifted = ShiftedPredictor(Oracle(), -12)  # type: ignore[arg-type]
    left, right = pair(disparity)
    (estimate,) = shifted.stages(left, right)
    assert estimate.disparity.shape == (4, 100)
    inside = slice(24, 76)
    np.testing.assert_array_equal(estimate.disparity[:, inside], disparity)
    assert shifted.predict(left, right, budget_ms=5, stage=2).disparity[0, 50] == disparity
    assert shifted.config == "its configuration"


def test_positive() -> None:
    left, right = pair(15)
    (estimate,) = ShiftedPredictor(Oracle(), 10).stages(left, right)  # type: ignore[arg-type]
    assert np.isnan(estimate.disparity[:, :10]).all()
    np.testing.assert_array_equal(estimate.disparity[:, 20:], 15)
    with pytest.raises(AnyNetError, match="expected min_disparity below the width of 100 pixels, got 100"):
        next(ShiftedPredictor(Oracle(), 100).stages(left, right))  # type: ignore[arg-type]
    with pytest.raises(
        AnyNetError, match="expected min_disparity as an integer from -100000 to 100000 pixels, got 1000000000"
    ):
        ShiftedPredictor(Oracle(), 10**9)  # type: ignore[arg-type]


@pytest.mark.parametrize("columns", [-5, 5])
def test_images_are_checked_as_they_were_given(columns: int) -> None:
    shifted = ShiftedPredictor(Oracle(), columns)  # type: ignore[arg-type]
    for image, got in ((np.zeros((4, 9), np.uint8), "[4, 9]"), (np.zeros(9, np.uint8), "[9]")):
        with pytest.raises(
            AnyNetError, match=re.escape(f"expected left as uint8 RGB array [H, W, 3], got uint8 {got}")
        ):
            shifted.predict(image, image, 5, 2)


@pytest.mark.parametrize("columns", [float("nan"), "3", -3.7, True, None])
def test_columns_are_whole_numbers(columns: object) -> None:
    with pytest.raises(
        AnyNetError,
        match=re.escape(f"expected min_disparity as an integer from -100000 to 100000 pixels, got {columns!r}"),
    ):
        ShiftedPredictor(Oracle(), columns)  # type: ignore[arg-type]


def test_from_matches_and_doffs() -> None:
    left, right, truth = stereo_motorcycle()
    cut = match_corners(left[:, 40:], right[:, :-40])
    calibration = Calibration(995, 0.19, 271, 255, doffs=71.086)
    found = min_disparity(calibration, cut)
    assert found <= float(truth.min()) - 40
    assert found >= -71
    assert min_disparity(Calibration(995, 0.19, 271, 255, doffs=20), cut) == -20
    assert min_disparity(Calibration(995, 0.19, 271, 255), cut) == 0
    assert min_disparity(None, cut) == 0
    assert min_disparity(calibration, match_corners(left, right)) == 0


def test_a_few_corners_of_the_background_are_enough() -> None:
    """Two fifths of this pair's disparities lie below 0, and 3 of 100 of its corners."""
    left, right, truth = stereo_motorcycle()
    window, moved = (slice(60, 360), slice(250, 610)), (slice(60, 360), slice(215, 575))
    least = float(truth[window].min()) - 35
    assert (truth[window] < 35).mean() > 0.35
    found = min_disparity(Calibration(995, 0.19, doffs=90), match_corners(left[window], right[moved]))
    assert -90 < found <= least
