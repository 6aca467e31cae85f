from __future__ import annotations

import numpy as np
import pytest

from anynet import AnyNetError, Estimate
from anynet.camera import Calibration
from anynet.trust import Trust, steep, within_reach


def estimate(**maps: np.ndarray) -> Estimate:
    return Estimate(4, np.full((4, 6), 10, np.float32), 1.0, **maps)


def test_what_is_dropped() -> None:
    confidence = np.linspace(0, 1, 24, dtype=np.float32).reshape(4, 6)
    occluded = np.zeros((4, 6), bool)
    occluded[2, 3] = True
    judged = estimate(confidence=confidence, occluded=occluded)
    np.testing.assert_array_equal(np.isnan(Trust(0.5).kept(judged)), confidence < 0.5)
    np.testing.assert_array_equal(np.isnan(Trust(drop_occluded=True).kept(judged)), occluded)
    np.testing.assert_array_equal(np.isnan(Trust(0.5, True).kept(judged)), (confidence < 0.5) | occluded)
    assert np.isfinite(judged.disparity).all()  # its own map stays
    assert Trust().kept(judged) is judged.disparity


def test_ramps_are_dropped_and_slanted_surfaces_kept() -> None:
    x = np.arange(40, dtype=np.float32)
    slanted = np.tile(0.3 * x, (5, 1))
    assert not steep(slanted).any()
    edge = np.tile(np.interp(x, [0, 18, 24, 40], [5, 5, 25, 25]).astype(np.float32), (5, 1))
    for ramp in edge, edge[:, ::-1], edge.T:
        found = steep(np.ascontiguousarray(ramp))
        assert found.any()
        np.testing.assert_array_equal(np.unique(ramp[~found].round(3)), [5, 25])


def test_needs_a_confidence() -> None:
    with pytest.raises(AnyNetError, match="expected an estimate with confidence"):
        Trust(0.5).kept(estimate())
    assert not Trust().asked


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), "0.5", True, None])
def test_wrong_confidence(value: object) -> None:
    with pytest.raises(AnyNetError, match="expected min_confidence from 0 to 1, got"):
        Trust(value)  # type: ignore[arg-type]


def test_wrong_flag() -> None:
    with pytest.raises(AnyNetError, match="expected drop_occluded as True or False, got 1"):
        Trust(0.5, 1)  # type: ignore[arg-type]


def test_reach() -> None:
    calibration = Calibration(focal=500, baseline=0.1)
    depth = np.array([[1, 19.9, 20.1, np.nan, np.inf]], np.float32)
    np.testing.assert_array_equal(within_reach(depth, calibration, None), [[True, True, False, False, False]])
    np.testing.assert_array_equal(within_reach(depth, calibration, 5.0), [[True, False, False, False, False]])
    assert within_reach(depth, calibration, float("inf"))[0, 2]
    off = calibration.depth(np.array([[2.5 + 0.5]], np.float32))  # half a pixel off
    assert off[0, 0] == pytest.approx(20 / 1.2)
