"""Samples through a preparation: rectified, moved apart, told about."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from anynet import Predictor
from anynet.camera import Calibration, Camera, PairPreparation, StereoRig
from anynet.data import StereoSample
from anynet.errors import AnyNetError
from anynet.evaluation.confidence import evaluate_confidence
from anynet.evaluation.evaluate import Image, evaluate
from anynet.evaluation.report import markdown
from anynet.predictor import Estimate


def sample_of(height: int, width: int, disparity: float) -> StereoSample:
    left, right = np.random.default_rng(0).integers(0, 256, (2, height, width, 3), dtype=np.uint8)
    truth = np.full((height, width), disparity, np.float32)
    return StereoSample(left, right, truth, np.ones_like(truth, bool), name="noise")


def test_raw_pairs_are_rectified() -> None:
    matrix = np.array([[90.0, 0, 47], [0, 90, 31], [0, 0, 1]])
    camera = Camera(matrix, np.array([-0.2, 0.05, 0, 0]))
    rig = StereoRig(camera, camera, np.eye(3), np.array([-0.1, 0, 0]), (96, 64))
    sample = sample_of(64, 96, 5)
    rectification = rig.rectify(alpha=1)
    given: list[Image] = []

    def method(left: Image, right: Image) -> Iterator[Estimate]:
        given.extend([left, right])
        yield Estimate(1, np.full(left.shape[:2], 5, np.float32), 1.0)

    with pytest.warns(UserWarning, match="raw cameras|rectified left view") as told:
        evaluation = evaluate(method, [sample, sample], prepare=PairPreparation(rig, alpha=1, check=False))
    assert [str(warning.message) for warning in told] == [
        "noise (and 1 more): rectified by the calibration of raw cameras",
        "noise (and 1 more): the truth is taken to be that of the rectified left view",
    ]
    for image, expected in zip(given, rectification(sample.left, sample.right) * 2, strict=True):
        np.testing.assert_array_equal(image, expected)
    scores = evaluation.stages[0].images[0]
    assert (scores.epe, scores.pixels) == (0, rectification.valid.sum())
    assert 0 < scores.pixels < 64 * 96


def test_negative_disparities_are_looked_for_and_count() -> None:
    def method(left: Image, right: Image) -> Iterator[Estimate]:
        assert left.shape == right.shape == (64, 96 + 40, 3)
        yield Estimate(1, np.full(left.shape[:2], 20, np.float32), 1.0)

    prepare = PairPreparation(min_disparity=-40, check=False)
    with pytest.warns(UserWarning, match="disparities looked for from -40 pixels on"):
        evaluation = evaluate(method, [sample_of(64, 96, -20)], prepare=prepare)
    assert evaluation.stages[0].images[0].epe == 0
    assert evaluation.stages[0].images[0].pixels == 64 * 96
    assert "-40 < d < 192." in markdown({("m", "d", "all"): evaluation})
    plain = evaluate(lambda left, right: [Estimate(1, np.ones((64, 96), np.float32), 1.0)], [sample_of(64, 96, 1)])
    assert " 0 < d < 192." in markdown({("m", "d", "all"): plain})


def test_another_size_is_refused() -> None:
    prepare = PairPreparation(Calibration(100, 0.1, size=(97, 64)))
    with pytest.raises(AnyNetError, match="expected images of 97 x 64 as the calibration says, got 96 x 64"):
        evaluate(lambda left, right: [], [sample_of(64, 96, 1)], prepare=prepare)


def test_confidence_of_pairs_moved_apart() -> None:
    prepare = PairPreparation(min_disparity=-8, check=False)
    with pytest.warns(UserWarning, match="from -8 pixels on"):
        scores = evaluate_confidence(Predictor(), [sample_of(32, 64, -4)], prepare=prepare)
    assert sorted(scores) == [1, 2, 3, 4]
