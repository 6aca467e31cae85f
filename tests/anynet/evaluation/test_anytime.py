"""The anytime setting on curves worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from anynet.errors import AnyNetError
from anynet.evaluation.anytime import (
    Curve,
    best_cascade,
    cascade,
    curve_of,
    curve_of_stages,
    mean_curve,
    one_after_another,
    random_queries,
)
from anynet.evaluation.evaluate import Evaluation, Stage
from anynet.evaluation.metrics import Scores, epe

CURVE = Curve((10.0, 100.0), (20.0, 5.0))


@pytest.mark.parametrize(("milliseconds", "error"), [(0, 100), (9.9, 100), (10, 20), (99.9, 20), (100, 5), (1e9, 5)])
def test_the_last_finished_map_counts(milliseconds, error):
    assert CURVE.at(milliseconds) == error


def test_area_over_the_logarithm_of_time():
    # One decade each: nothing, the first map, the second.
    assert CURVE.area(1, 1000) == pytest.approx((100 + 20 + 5) / 3)
    assert CURVE.area(10, 100) == pytest.approx(20)
    assert CURVE.area(200, 300) == pytest.approx(5)
    assert CURVE.area(1, 5) == pytest.approx(100)
    assert CURVE.area() == pytest.approx(
        (100 * math.log(10 / 5) + 20 * math.log(10) + 5 * math.log(10)) / math.log(200)
    )
    with pytest.raises(AnyNetError, match="expected 0 < first_ms < last_ms, got 5 and 5"):
        CURVE.area(5, 5)


def test_area_is_the_mean_error_of_queries_uniform_in_the_logarithm():
    queries = random_queries(20_000)
    assert queries.min() >= 5
    assert queries.max() <= 1000
    assert np.median(queries) == pytest.approx(math.sqrt(5 * 1000), rel=0.05)
    assert np.mean([CURVE.at(query) for query in queries]) == pytest.approx(CURVE.area(), rel=0.02)


def test_wasted_is_what_was_under_way():
    assert CURVE.wasted([4]) == 4
    assert CURVE.wasted([10]) == 0
    assert CURVE.wasted([60]) == 50
    assert CURVE.wasted([100, 500]) == 0  # finished: nothing was under way
    assert CURVE.wasted([4, 60, 500]) == 18
    with pytest.raises(AnyNetError, match="at least one query"):
        CURVE.wasted([])


@pytest.mark.parametrize(
    ("times", "errors", "message"),
    [
        ((), (), "as many times as errors, got 0 and 0"),
        ((1.0,), (1.0, 2.0), "got 1 and 2"),
        ((2.0, 1.0), (1.0, 2.0), "never fall"),
        ((0.0,), (1.0,), "above 0"),
        ((1.0, math.nan), (1.0, 2.0), "never fall"),
    ],
)
def test_what_is_no_curve(times, errors, message):
    with pytest.raises(AnyNetError, match=message):
        Curve(times, errors)


def test_the_curve_of_maps():
    truth = np.float32([[10, 20]])
    mask = np.ones((1, 2), bool)
    maps = [(np.float32([[0, 0]]), 3), (np.float32([[10, 0]]), 8), (truth, 20)]
    assert curve_of(maps, truth, mask) == Curve((3.0, 8.0, 20.0), (100.0, 50.0, 0.0))
    assert curve_of(maps, truth, mask, epe).errors == (15.0, 10.0, 0.0)


def test_the_curve_of_an_evaluation():
    scores = [Scores(1, 2, 3, 4, d1, 100) for d1 in (30.0, 10.0, 8.0, 6.0)]
    stages = Stage(1, (scores[0], scores[1]), 5.0, 100.0), Stage(2, (scores[2], scores[3]), 9.0, 100.0)
    evaluation = Evaluation(("a", "b"), stages)
    assert curve_of_stages(evaluation) == Curve((5.0, 9.0), (20.0, 7.0))
    assert curve_of_stages(evaluation, "epe").errors == (1, 1)


def test_runs_one_after_another():
    assert one_after_another([("coarse", 5.0), ("fine", 20.0), ("full", 80.0)]) == [
        ("coarse", 5.0),
        ("fine", 25.0),
        ("full", 105.0),
    ]


def test_the_mean_of_curves_steps_where_each_does():
    mean = mean_curve([Curve((10.0, 30.0), (20.0, 10.0)), Curve((20.0,), (4.0,))])
    assert mean == Curve((10.0, 20.0, 30.0), (60.0, 12.0, 7.0))
    with pytest.raises(AnyNetError, match="at least one curve"):
        mean_curve([])


def test_a_cascade_hands_out_nothing_worse():
    fast, slow = Curve((5.0, 10.0), (30.0, 20.0)), Curve((50.0, 90.0), (25.0, 4.0))
    assert cascade([fast, slow]) == Curve((5.0, 10.0, 60.0, 100.0), (30.0, 20.0, 20.0, 4.0))
    with pytest.raises(AnyNetError, match="at least one curve"):
        cascade([])


def test_the_best_cascade():
    # The slow one is worth its time only after the fast one; the middle one only delays it.
    fast, middle, slow = Curve((5.0,), (20.0,)), Curve((90.0,), (19.0,)), Curve((100.0,), (4.0,))
    assert best_cascade({"slow": slow, "fast": fast, "middle": middle}) == [("fast", 1), ("slow", 1)]
    # The fast one's last stage brings less than it delays.
    fast = Curve((5.0, 60.0), (20.0, 19.9))
    assert best_cascade({"slow": slow, "fast": fast}) == [("fast", 1), ("slow", 1)]
    assert best_cascade({"fast": fast}) == [("fast", 2)]
    with pytest.raises(AnyNetError, match=r"100,000 choices of stages, got 1$"):
        best_cascade({})
