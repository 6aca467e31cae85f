from __future__ import annotations

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from anynet.camera.check import check_rectified
from anynet.io import read_pair

SHARED = Path(__file__).parents[3] / ".." / "shared" / "data"


def real_pairs() -> list[tuple[Path, Path]]:
    patterns = [
        ("kitti2015/training/image_2/*_10.png", "image_2", "image_3"),
        ("kitti_object/left/*.png", "left", "right"),
        ("sceneflow/*/RGB_cleanpass/left/*.png", "left", "right"),
        ("middlebury2006/*/view1.png", "view1", "view5"),
        ("middlebury2003/teddy/im2.png", "im2", "im6"),
        ("middlebury2014Q/*/im0.png", "im0", "im1"),
        ("eth3d/*/im0.png", "im0", "im1"),
    ]
    return [
        (left, SHARED / str(left.relative_to(SHARED)).replace(old, new))
        for pattern, old, new in patterns
        for left in sorted(SHARED.glob(pattern))
    ]


def rotated(image: np.ndarray, degrees: float) -> np.ndarray:
    height, width = image.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 1)
    return cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)


def check(left: np.ndarray, right: np.ndarray) -> None:
    """A good pair gives no finding, its spoiled versions one each."""
    assert check_rectified(left, right) == []
    (swapped,) = check_rectified(right, left)
    assert swapped.startswith("left and right look swapped: ")
    (shifted,) = check_rectified(left, np.roll(right, 5, axis=0))
    assert shifted.startswith("the pair looks unrectified: ")
    (turned,) = check_rectified(left, rotated(right, 1))
    assert turned.startswith("the pair looks unrectified: ")


def test_motorcycle() -> None:
    check(*stereo_motorcycle()[:2])


def test_what_was_seen_is_told() -> None:
    left, right, _ = stereo_motorcycle()
    (shifted,) = check_rectified(left, np.roll(right, 5, axis=0))
    assert "rows apart (median), expected 0" in shifted
    assert float(shifted.split(" rows apart")[0].split()[-1]) == pytest.approx(5, abs=0.3)


def test_large_images_are_told_in_their_own_pixels() -> None:
    left, right = (cv2.resize(image, None, fx=4, fy=4) for image in stereo_motorcycle()[:2])
    (near,) = check_rectified(left, right)
    assert "have disparities above 192 pixels" in near
    assert "use --input-scale 0." in near
    assert check_rectified(left, right, reach=384) == []
    (near,) = check_rectified(left, right, smallest=-100)
    assert "above 92 pixels" in near
    assert "finds from -100 on: use --input-scale 0.5" in near
    (shifted,) = check_rectified(left, np.roll(right, 20, axis=0), reach=384)
    rows = float(shifted.split(" rows apart")[0].split()[-1])
    assert rows == pytest.approx(20, abs=2)


def test_swapped_and_shifted_are_both_told() -> None:
    left, right, _ = stereo_motorcycle()
    assert len(check_rectified(right, np.roll(left, 5, axis=0))) == 2


@pytest.mark.parametrize("size", [(1, 1), (5, 7), (40, 40), (300, 400)])
def test_nothing_is_said_where_nothing_matches(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    flat = np.full((*size, 3), 100, np.uint8)
    noise = [rng.integers(0, 256, (*size, 3), dtype=np.uint8) for _ in range(2)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert check_rectified(flat, flat) == []
        assert check_rectified(flat, flat.copy()) == []
        assert check_rectified(flat, noise[0]) == []
        assert check_rectified(*noise) == []


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.exists(), reason="the real pairs are not in ../shared/data")
def test_every_real_pair() -> None:
    pairs = real_pairs()
    assert len(pairs) >= 56
    for left, right in pairs:
        check(*read_pair(left, right))


def test_the_same_picture_twice() -> None:
    left, _, _ = stereo_motorcycle()
    (finding,) = check_rectified(left, left.copy())
    assert finding.startswith("left and right are the same picture")


def test_negative_disparities_are_no_swap_where_doffs_explains_them() -> None:
    left, right, _ = stereo_motorcycle()
    cut = left[:, 60:], right[:, :-60]
    assert check_rectified(*cut)[0].startswith("left and right look swapped")
    assert check_rectified(*cut, doffs=91.086) == []
    (finding,) = check_rectified(left[:, 40:], right[:, :-40], doffs=5)
    assert "negative disparities, down to" in finding
    assert "--min-disparity -" in finding
