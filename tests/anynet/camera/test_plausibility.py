from __future__ import annotations

import pytest

from anynet.camera import Calibration, check_calibration
from anynet.camera.plausibility import check_baseline, reach_of, scale_for

GOOD = Calibration(focal=995, baseline=0.19, cx=311, cy=255, doffs=31)


@pytest.mark.parametrize("baseline", [0.0142, 0.05, 0.193, 1.2])
def test_real_baselines(baseline: float) -> None:
    assert check_baseline(baseline) == []


@pytest.mark.parametrize(("baseline", "word"), [(193.0, "millimeters"), (19.3, "centimeters"), (0.0001, "short")])
def test_other_units(baseline: float, word: str) -> None:
    (finding,) = check_baseline(baseline)
    assert word in finding
    assert f"{baseline:g} m" in finding
    assert "--calib-unit" in finding


def test_the_most_counts_from_the_smallest_disparity_on() -> None:
    seen = Calibration(995, 0.19, 311, 255, ndisp=280)
    assert check_calibration(seen, 741, 500, smallest=100) == []
    (finding,) = check_calibration(seen, 741, 500, smallest=-100)
    assert "those up to 92: use --input-scale 0.48 or less" in finding


def test_a_good_calibration() -> None:
    assert check_calibration(GOOD, 741, 500) == []
    assert check_calibration(Calibration(995, 0.19), 741, 500) == []


@pytest.mark.parametrize(
    ("calibration", "messages"),
    [
        (Calibration(995, 0.19, 812, 562), ["cx 812 of 741", "cy 562 of 500"]),
        (Calibration(995, 0.19, 622, 255), ["far from the image's center (cx 622"]),
        (Calibration(100, 0.19, 311, 255), ["a focal length of 100 pixels is implausible"]),
        (Calibration(90000, 0.19, 311, 255), ["a focal length of 90000 pixels is implausible"]),
        (Calibration(995, 0.19, 311, 255, -239.5), ["disparities above 239.5 pixels have a depth"]),
        (Calibration(995, 0.19, 311, 255, 400), ["more than half the images' width"]),
        (Calibration(995, 0.19, 311, 255, ndisp=280), ["up to 280 pixels (ndisp)"]),
        (Calibration(995, 0.19, 311, 255, ndisp=741), []),  # ETH3D's files have the width there
        (Calibration(995, 0.19, 311, 255, ndisp=70), []),
    ],
)
def test_findings(calibration: Calibration, messages: list[str]) -> None:
    findings = check_calibration(calibration, 741, 500)
    assert len(findings) == len(messages)
    for finding, message in zip(findings, messages, strict=True):
        assert message in finding


@pytest.mark.parametrize("disparity", [193, 280, 300, 1000])
def test_the_scale_that_is_advised_is_enough(disparity: float) -> None:
    assert reach_of(scale_for(disparity)) >= disparity
    assert scale_for(disparity) > 0.7 * 192 / disparity


def test_enlarged_images_are_searched_farther() -> None:
    assert (reach_of(None), reach_of(2), reach_of(0.5)) == (192, 192, 384)
