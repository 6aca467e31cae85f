from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from skimage.data import stereo_motorcycle

from anynet.camera import Calibration, PairPreparation, ShiftedPredictor
from anynet.errors import AnyNetError

from . import rendering

GOOD = Calibration(994.978, 0.193001, 311.193, 254.877, 31.086, (741, 500))


@pytest.fixture(scope="module")
def motorcycle() -> tuple[np.ndarray, np.ndarray]:
    left, right, _ = stereo_motorcycle()
    return left, right


def test_a_good_pair_passes_as_it_is(motorcycle: tuple[np.ndarray, np.ndarray]) -> None:
    for cameras in (None, GOOD):
        pair = PairPreparation(cameras)(*motorcycle)
        assert pair.left is motorcycle[0]
        assert pair.right is motorcycle[1]
        assert (pair.warnings, pair.notes, pair.min_disparity, pair.calibration) == ((), (), 0, cameras)
        assert pair.predictor("a predictor") == "a predictor"  # type: ignore[arg-type]


def test_another_size(motorcycle: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(AnyNetError, match="expected images of 741 x 500 as the calibration says, got 100 x 90"):
        PairPreparation(GOOD)(*(image[:90, :100] for image in motorcycle))


def test_raw_rectified_or_as_the_calibration_says() -> None:
    rig = rendering.rig()
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    rectification = rig.rectify()
    both = replace(rectification.calibration, rig=rig)
    rectified = rectification(noise, noise)
    for cameras, raw, warped in ((rig, None, True), (rig, False, False), (both, None, False), (both, True, True)):
        pair = PairPreparation(cameras, raw=raw, check=False)(noise, noise)
        assert pair.calibration == rectification.calibration
        np.testing.assert_array_equal(pair.left, rectified[0] if warped else noise)
        assert (pair.valid is not None) == warped
    told = replace(rectification.calibration, focal=300.0)
    rig = rig.with_rectified(told)
    for raw, alpha, expected in (
        (False, None, told), (None, None, rectification.calibration), (False, 0.5, rig.rectify(0.5).calibration)
    ):  # fmt: skip
        assert PairPreparation(rig, raw=raw, alpha=alpha, check=False)(noise, noise).calibration == expected
    with pytest.raises(AnyNetError, match=r"expected a calibration of raw cameras .* \(--raw\), got none"):
        PairPreparation(GOOD, raw=True)


def test_alpha_belongs_to_raw_cameras() -> None:
    assert PairPreparation(rendering.rig(), alpha=0)
    assert PairPreparation(replace(GOOD, rig=rendering.rig()), raw=True, alpha=0)
    for cameras, message in (
        (None, "alpha .--alpha. belongs to a calibration of raw cameras, got none$"),
        (GOOD, "alpha .--alpha. belongs to a calibration of raw cameras, got none"),
        (replace(GOOD, rig=rendering.rig()), "if the images are raw, use --raw"),
    ):
        with pytest.raises(AnyNetError, match=message):
            PairPreparation(cameras, alpha=0)


def test_rows_are_told_and_fixed(motorcycle: tuple[np.ndarray, np.ndarray]) -> None:
    lower = np.roll(motorcycle[1], 3, axis=0)
    (warning,) = PairPreparation(GOOD)(motorcycle[0], lower).warnings
    assert warning.startswith("the pair looks unrectified")
    assert "--raw" not in warning
    (warning,) = PairPreparation(replace(GOOD, rig=rendering.rig()))(motorcycle[0], lower).warnings
    assert warning.endswith("if the images are raw, use --raw")
    pair = PairPreparation(GOOD, fix_rows=True)(motorcycle[0], lower)
    assert pair.warnings == ()
    assert pair.notes[0].startswith("the right image was 2.9")
    flat = np.zeros_like(lower)
    assert PairPreparation(GOOD, fix_rows=True)(flat, flat).warnings[0].startswith("rows not corrected")
    assert PairPreparation(GOOD, check=False)(motorcycle[0], lower).warnings == ()


def test_what_is_no_pair_or_calibration(motorcycle: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(AnyNetError, match="expected cameras as read_calibration gives them, got str"):
        PairPreparation("calib.txt")  # type: ignore[arg-type]
    left, right = motorcycle
    for one, other, message in (
        (left[..., 0], right[..., 0], r"expected left as uint8 RGB array \[H, W, 3\], got uint8 \[500, 741\]"),
        (left, right / np.float32(255), "expected right as uint8 RGB array .* got float32"),
        (left, right[:99], "one size"),
        (torch.from_numpy(left), torch.from_numpy(right), "expected left as uint8 RGB array .* got Tensor"),
    ):
        with pytest.raises(AnyNetError, match=message):
            PairPreparation()(one, other)


def test_negative_disparities(motorcycle: tuple[np.ndarray, np.ndarray]) -> None:
    left, right = motorcycle[0][:, 60:], motorcycle[1][:, :-60]
    calibration = Calibration(994.978, 0.193001, 251.193, 254.877, 91.086, (681, 500))
    pair = PairPreparation(calibration)(left, right)
    assert pair.warnings == ()
    assert -91 <= pair.min_disparity <= -53
    assert PairPreparation(calibration, check=False)(left, right).min_disparity == pair.min_disparity
    assert isinstance(pair.predictor("a predictor"), ShiftedPredictor)  # type: ignore[arg-type]
    assert PairPreparation(calibration, min_disparity=-7)(left, right).min_disparity == -7


def test_what_is_known() -> None:
    flat = np.zeros((2, 3, 3), np.uint8)
    disparity = np.array([[-30, -5, 0], [1, 40, np.nan]], np.float32)

    def known(cameras: Calibration | None, smallest: int | None = None) -> list[list[bool]]:
        result = PairPreparation(cameras, min_disparity=smallest)(flat, flat).known(disparity)
        assert np.array_equal(result[~np.isnan(result)], disparity[~np.isnan(result)])
        return (~np.isnan(result)).tolist()

    assert known(None) == [[False, False, False], [True, True, False]]
    assert known(Calibration(3, 1, doffs=20)) == [[False, False, False], [True, True, False]]
    assert known(Calibration(3, 1, doffs=20), -40) == [[False, True, True], [True, True, False]]
    assert known(Calibration(3, 1, doffs=-20)) == [[False, False, False], [False, True, False]]
    assert known(None, -40) == [[True, True, True], [True, True, False]]
    disparity[0, 0] = 1e-6  # a depth of 3000 km
    assert known(Calibration(3, 1)) == [[False, False, False], [True, True, False]]
