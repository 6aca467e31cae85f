"""Metrics on cases worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from anynet.errors import AnyNetError
from anynet.evaluation import metrics

TRUTH = np.array([[10, 20, 100, 150]], np.float32)
PREDICTION = np.array([[11.5, 23.5, 104, 160]], np.float32)  # off by 1.5, 3.5, 4 (4 % of 100), 10
ALL = np.ones((1, 4), bool)


def test_by_hand() -> None:
    scores = metrics.scores(PREDICTION, TRUTH, ALL)
    assert scores == metrics.Scores(epe=19 / 4, bad1=100, bad2=75, bad3=75, d1=50, pixels=4)
    assert metrics.epe(PREDICTION, TRUTH, ALL) == scores.epe
    assert metrics.bad(PREDICTION, TRUTH, ALL, 3) == scores.bad3
    assert metrics.bad(PREDICTION, TRUTH, ALL, 5) == 25
    assert metrics.d1(PREDICTION, TRUTH, ALL) == scores.d1


def test_exactly_at_the_threshold_is_not_bad() -> None:
    assert metrics.bad(np.array([[13]], np.float32), np.array([[10]], np.float32), np.ones((1, 1), bool), 3) == 0
    assert metrics.d1(np.array([[105]], np.float32), np.array([[100]], np.float32), np.ones((1, 1), bool)) == 0


def test_only_the_mask_counts() -> None:
    mask = np.array([[True, False, False, True]])
    assert metrics.scores(PREDICTION, TRUTH, mask) == metrics.Scores(5.75, 100, 50, 50, 50, 2)
    truth = np.where(mask, TRUTH, np.float32(np.nan))
    assert metrics.scores(PREDICTION, truth, mask) == metrics.Scores(5.75, 100, 50, 50, 50, 2)


def test_a_missing_prediction_is_wrong() -> None:
    scores = metrics.scores(np.full_like(TRUTH, np.nan), TRUTH, ALL)
    assert scores == metrics.Scores(math.inf, 100, 100, 100, 100, 4)


def test_no_pixels_give_nan() -> None:
    scores = metrics.scores(PREDICTION, TRUTH, ~ALL)
    assert scores.pixels == 0
    assert all(math.isnan(getattr(scores, name)) for name in metrics.METRICS)


def test_pooled_weighs_pixels_and_mean_weighs_images() -> None:
    large = metrics.Scores(epe=1, bad1=10, bad2=10, bad3=10, d1=10, pixels=300)
    small = metrics.Scores(epe=5, bad1=50, bad2=50, bad3=50, d1=50, pixels=100)
    empty = metrics.scores(PREDICTION, TRUTH, ~ALL)
    assert metrics.pooled([large, small, empty]) == metrics.Scores(2, 20, 20, 20, 20, 400)
    assert metrics.mean([large, small, empty]) == metrics.Scores(3, 30, 30, 30, 30, 400)


def test_shapes_must_agree() -> None:
    with pytest.raises(AnyNetError, match=r"one shape, got \(1, 4\), \(1, 4\), \(1, 3\)"):
        metrics.epe(PREDICTION, TRUTH, ALL[:, :3])
