from __future__ import annotations

import numpy as np
import pytest

from anynet.errors import AnyNetError
from anynet.evaluation.truth import check_truth, with_truth
from anynet.samples import StereoSample

RNG = np.random.default_rng(0)
ESTIMATE = RNG.uniform(5, 100, (30, 40)).astype(np.float32)


def findings(truth: np.ndarray, valid: np.ndarray | None = None) -> list[str]:
    image = np.zeros((30, 40, 3), np.uint8)
    known = np.isfinite(truth) if valid is None else valid
    return check_truth(StereoSample(image, image, truth.astype(np.float32), known), ESTIMATE)


def test_a_truth_that_may_be_one() -> None:
    noisy = ESTIMATE * RNG.uniform(0.8, 1.2, ESTIMATE.shape)
    assert findings(noisy) == []
    assert findings(RNG.uniform(1, 190, ESTIMATE.shape)) == []  # the estimate is bad, not the scale
    assert findings(np.full(ESTIMATE.shape, np.nan)) == []


@pytest.mark.parametrize(("factor", "word"), [(0.25, "0.25"), (4, "4"), (1.6, "1.6")])
def test_another_scale(factor: float, word: str) -> None:
    (finding,) = findings(ESTIMATE * factor * RNG.uniform(0.95, 1.05, ESTIMATE.shape))
    assert f"about {word} times the estimated" in finding


def test_the_other_sign_and_the_wrong_range() -> None:
    (finding,) = findings(-ESTIMATE)
    assert "all known disparities are negative" in finding
    (finding,) = findings(0 * ESTIMATE)
    assert "the known disparities are 0.0 to 0.0" in finding
    (finding,) = findings(ESTIMATE + 300)
    assert "no pixel counts (0 < d < 192): the known disparities are 30" in finding


def sample_of(name: str, disparity: float) -> StereoSample:
    truth = np.full((2, 3), disparity, np.float32)
    return StereoSample(*np.zeros((2, 2, 3, 3), np.uint8), truth, np.isfinite(truth), name=name)


def test_pairs_without_truth_are_told_and_left_out() -> None:
    samples = [sample_of(str(number), np.nan) for number in range(10)] + [sample_of("known", 1)]
    with pytest.warns(UserWarning, match="no known disparity") as told:
        assert [sample.name for sample in with_truth(samples)] == ["known"]
    assert [str(w.message) for w in told] == ["0, 1, 2, 3, 4, 5, 6, 7 (and 2 more): no known disparity, left out"]
    with pytest.raises(AnyNetError, match="expected pairs with known disparities to evaluate on, got none: 0, 1"):
        list(with_truth(samples[:2]))
