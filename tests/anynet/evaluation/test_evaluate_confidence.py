from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anynet import Predictor
from anynet.cli import main
from anynet.data import open_dataset
from anynet.evaluation.confidence import Calibration, evaluate_confidence, sparsification
from anynet.evaluation.metrics import within_d1


def test_sparsification_of_a_perfect_order() -> None:
    correct = np.array([True] * 8 + [False] * 2)
    d1, sparse, oracle, ause = sparsification(np.linspace(1, 0, 10, dtype=np.float32), correct)
    assert (d1, sparse, oracle, ause) == pytest.approx((20, 0, 0, 0))


def test_sparsification_of_the_worst_order() -> None:
    correct = np.array([True] * 5 + [False] * 5)
    d1, sparse, oracle, ause = sparsification(np.linspace(0, 1, 10, dtype=np.float32), correct)
    assert (d1, sparse, oracle) == pytest.approx((50, 62.5, 37.5))
    left = np.arange(1, 11)
    curves = np.minimum(left, 5) / left - np.maximum(left - 5, 0) / left
    assert ause == pytest.approx(100 * curves.mean())


def test_calibration_error() -> None:
    calibration = Calibration()
    confidence = np.full(1000, 0.9, np.float32)
    calibration.add(confidence, np.arange(1000) < 900)
    assert calibration.error == pytest.approx(0, abs=1e-6)
    calibration.add(np.full(1000, 0.5, np.float32), np.zeros(1000, bool))
    assert calibration.error == pytest.approx(0.25)
    calibration.add(np.ones(1, np.float32), np.ones(1, bool))  # the last bin has its end


def test_right_by_d1() -> None:
    truth = np.array([10, 10, 100, 100], np.float32)
    off = np.array([3, 3.1, 5, 5.1], np.float32)
    np.testing.assert_array_equal(within_d1(truth + off, truth), [True, False, True, False])
    assert not within_d1(np.array([np.nan], np.float32), truth[:1]).any()


def test_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = "render:1?height=96&width=160"
    assert main(["evaluate", "--confidence", "--data", data, "--out", str(tmp_path), "--left-right"]) == 0
    out = capsys.readouterr().out
    assert out == (tmp_path / "confidence.md").read_text()
    assert out.count("| default |") == 4
    (entry,) = json.loads((tmp_path / "confidence.json").read_text())
    for scores in entry["stages"].values():
        assert 0 <= scores["d1_oracle"] <= scores["d1_sparse"]
        assert 0 <= scores["calibration_error"] <= 1
        assert scores["ause"] >= 0


def test_what_excludes_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--data", "render:1", "--left-right"]) == 2
    assert "--left-right belongs to --confidence" in capsys.readouterr().err
    assert main(["evaluate", "--data", "render:1", "--confidence", "--method", "bm"]) == 2
    assert "--confidence excludes" in capsys.readouterr().err


def test_truth_in_another_scale_is_told() -> None:
    predictor, (sample,) = Predictor("default"), open_dataset("render:1?height=192&width=320")
    estimate = predictor.predict(sample.left, sample.right).disparity
    scaled = replace(sample, disparity=estimate / 4, valid=estimate > 0)
    with pytest.warns(UserWarning, match="is their scale right"):
        evaluate_confidence(predictor, [scaled])
