from __future__ import annotations

import math
import re

import cv2
import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from anynet.camera import Calibration, RowShift, RowWatch, fit_rows, match_corners


def moved(image: np.ndarray, shift: float, roll: float) -> np.ndarray:
    """The image with each pixel `shift` rows lower and turned clockwise by `roll` about its center."""
    height, width = image.shape[:2]
    x, y = (width - 1) / 2, (height - 1) / 2
    matrix = cv2.getRotationMatrix2D((x, y), -math.degrees(roll), 1)
    matrix[1, 2] += shift
    return cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray]:
    left, right, _ = stereo_motorcycle()
    return left, right


@pytest.mark.parametrize(("shift", "roll"), [(0, 0), (1.5, 0), (-4, 0), (0, 0.01), (2.25, -0.015)])
def test_found_and_removed(pair: tuple[np.ndarray, np.ndarray], shift: float, roll: float) -> None:
    left, right = pair[0], moved(pair[1], shift, roll)
    found = fit_rows(match_corners(left, right))
    assert found is not None
    assert found.shift == pytest.approx(shift, abs=0.1)
    assert found.roll == pytest.approx(roll, abs=0.0007)
    corrected = match_corners(left, found.corrected(right))
    assert corrected.rows_apart < 0.3
    x = corrected.points[:, 0] + corrected.offsets[:, 0]  # the disparities stay, too
    before = match_corners(*pair)
    assert np.median(corrected.disparities) == pytest.approx(np.median(before.disparities), abs=1.5)
    assert x.min() > -10


def test_a_correction_of_nothing_changes_nothing(pair: tuple[np.ndarray, np.ndarray]) -> None:
    np.testing.assert_array_equal(RowShift(0, 0).corrected(pair[1]), pair[1])


def test_what_is_no_small_error(pair: tuple[np.ndarray, np.ndarray]) -> None:
    assert fit_rows(match_corners(pair[0], moved(pair[1], 0, 0.3))) is None
    assert fit_rows(match_corners(np.zeros_like(pair[0]), pair[1])) is None


def test_watch(pair: tuple[np.ndarray, np.ndarray]) -> None:
    watch = RowWatch(every=3, looks=3)
    drifted = moved(pair[1], 1, 0)
    assert [watch(*pair) for _ in range(7)] == [None] * 7
    told = [watch(pair[0], drifted) for _ in range(12)]
    assert sum(message is not None for message in told) == 1
    assert "matched corners lie 1.0 rows apart" in next(message for message in told if message)
    assert [watch(*pair) for _ in range(9)] == [None] * 9
    assert any(watch(pair[0], drifted) for _ in range(9))  # good in between, so it is told again


def test_watch_tells_of_disparities_below_those_looked_for(pair: tuple[np.ndarray, np.ndarray]) -> None:
    cut = pair[0][:, 45:], pair[1][:, :-45]  # disparities are as many pixels smaller
    doffs = Calibration(focal=1000, baseline=0.2, doffs=90)
    watch = RowWatch(every=1)
    assert watch(*pair, doffs) is None
    told = watch(*cut, doffs)
    assert told is not None
    assert re.fullmatch(
        r"matched corners have disparities down to -\d\d pixels, which are looked for from 0 on: "
        r"use --min-disparity -\d\d",
        told,
    )
    assert watch(*cut, doffs) is None
    needed = int(told.split()[-1])
    for calibration, smallest in ((doffs, needed), (doffs, needed + 10), (Calibration(1000, 0.2), 0), (None, 0)):
        assert RowWatch(every=1)(*cut, calibration, smallest) is None


def test_watch_of_disparities_from_a_positive_one_on(pair: tuple[np.ndarray, np.ndarray]) -> None:
    """Of this pair they go from some 5 to 60 pixels."""
    away = pair[0][:, :-20], pair[1][:, 20:]  # as many pixels larger
    cut = pair[0][:, 20:], pair[1][:, :-20]
    for calibration in (None, Calibration(1000, 0.2), Calibration(1000, 0.2, doffs=30)):
        assert RowWatch(every=1)(*away, calibration, 20) is None
        told = RowWatch(every=1)(*pair, calibration, 20)
        assert told is not None
        assert re.fullmatch(
            r"matched corners have disparities down to \d+ pixels, which are looked for from 20 on: "
            r"use --min-disparity 0",
            told,
        )
    assert "which are looked for from 20 on: use --min-disparity 0" in (RowWatch(every=1)(*cut, None, 20) or "")


def test_watch_says_where_doffs_is_the_limit(pair: tuple[np.ndarray, np.ndarray]) -> None:
    cut = pair[0][:, 60:], pair[1][:, :-60]
    told = RowWatch(every=1)(*cut, Calibration(1000, 0.2, doffs=5))
    assert told is not None
    assert re.search(r"down to -\d\d pixels, .* use --min-disparity -5 \(doffs is 5: no depth below\)$", told)


def test_watch_says_nothing_of_what_it_cannot_see() -> None:
    flat = np.zeros((48, 64, 3), np.uint8)
    watch = RowWatch(every=1)
    assert [watch(flat, flat) for _ in range(3)] == [None] * 3
