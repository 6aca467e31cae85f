"""Augmentation leaves a proper pair: the truth still says where the pixels are."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from anynet.data import RenderedSample, StereoSample
from anynet.data.augment import augment, mirrored, non_occluded, random_crop
from anynet.errors import AnyNetError
from anynet.synthetic import render

CROP = (128, 256)


@pytest.fixture(scope="module")
def rendered() -> RenderedSample:
    return render(12, 256, 512, preset="things", sensor=False)


def mismatch(sample: StereoSample, offset: float = 0.0) -> float:
    """Mean difference between the left view and the right one warped by disparity + offset, where both see it."""
    height, width = sample.disparity.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    warped = cv2.remap(
        np.ascontiguousarray(sample.right), x - sample.disparity - np.float32(offset), y, cv2.INTER_LINEAR
    )
    inside = sample.valid & sample.noc & (x - sample.disparity - offset >= 0)
    return float(np.abs(warped.astype(np.float32) - sample.left).mean(2)[inside].mean())


def is_pair(sample: StereoSample) -> bool:
    return mismatch(sample) < 0.7 * min(mismatch(sample, -2.5), mismatch(sample, 2.5))


@pytest.mark.parametrize("seed", range(8))
def test_geometry_stays_true(rendered: RenderedSample, seed: int) -> None:
    changed = augment(rendered, CROP, np.random.default_rng(seed), photometric=False, occluders=0)
    assert changed.left.shape == changed.right.shape == (*CROP, 3)
    assert changed.disparity.shape == changed.valid.shape == changed.noc.shape == CROP
    assert is_pair(changed)


def test_pair_shifted_by_a_scale_would_be_seen(rendered: RenderedSample) -> None:
    changed = augment(rendered, CROP, np.random.default_rng(0), photometric=False, occluders=0)
    assert not is_pair(replace(changed, disparity=changed.disparity * 1.25))


def test_scale_multiplies_disparities() -> None:
    flat = np.full((100, 200), 10, np.float32)
    image = np.zeros((100, 200, 3), np.uint8)
    sample = StereoSample(image, image, flat, np.ones_like(flat, bool))
    for seed in range(20):
        changed = augment(sample, (64, 96), np.random.default_rng(seed), scales=(0.8, 1.5))
        assert len(np.unique(changed.disparity)) == 1
        assert 7.9 <= changed.disparity[0, 0] <= 15.2
        assert not changed.noc[:, : int(changed.disparity[0, 0])].any()


@pytest.mark.parametrize("scale", [0.6, 0.8, 1.25, 1.6])
def test_scaled_truth_lies_where_the_scaled_image_does(scale: float) -> None:
    rows = np.repeat(np.arange(200, dtype=np.float32)[:, None], 240, 1)
    image = np.repeat(rows[..., None].astype(np.uint8), 3, 2)
    sample = StereoSample(image, image, rows / 4, rows > 100, foreground=rows > 100)
    crop = (round(scale * 200), round(scale * 240))
    dice = np.random.default_rng(0)
    changed = augment(sample, crop, dice, scales=(scale, scale), photometric=False, occluders=0)
    apart = changed.disparity * 4 / scale - changed.left[..., 0]
    assert abs(apart[2:-2].mean()) < 0.15  # at the border, the image repeats itself
    below = changed.disparity * 4 / scale > 100.5
    assert np.array_equal(changed.valid, below)
    assert np.array_equal(changed.foreground, below)


def test_what_the_right_image_shows_is_not_occluded() -> None:
    image = np.zeros((20, 60, 3), np.uint8)
    disparity = np.full((20, 60), 10, np.float32)
    valid = np.ones_like(disparity, bool)
    valid[0] = False
    disparity[0] = np.nan
    sample = StereoSample(image, image, disparity, valid)
    expected = valid.copy()
    expected[:, :10] = False
    assert np.array_equal(non_occluded(sample), expected)
    patch = np.zeros_like(valid)
    patch[5:9, 30:33] = True
    expected[5:9, 40:43] = False
    assert np.array_equal(non_occluded(sample, patch), expected)
    noc = valid.copy()
    noc[15:] = expected[15:] = False
    assert np.array_equal(non_occluded(replace(sample, noc=noc), patch), expected)


def test_mirrored_is_a_pair_and_an_involution_of_the_truth(rendered: RenderedSample) -> None:
    other = mirrored(rendered)
    assert is_pair(other)
    assert np.array_equal(other.disparity[:, ::-1], rendered.right_disparity)
    assert np.array_equal(other.left[:, ::-1], rendered.right)


def test_views_are_exposed_apart_and_the_right_one_is_occluded(rendered: RenderedSample) -> None:
    same = replace(random_crop(rendered, CROP, np.random.default_rng(0)), right=None)
    same = replace(same, right=same.left, disparity=np.zeros(CROP, np.float32), noc=None)
    apart = hidden = 0
    for seed in range(20):
        lit = augment(same, CROP, np.random.default_rng(seed), scales=(1, 1), occluders=0)
        apart += not np.array_equal(lit.left, lit.right)
        covered = augment(same, CROP, np.random.default_rng(seed), scales=(1, 1), photometric=False, occluders=1)
        different = (covered.left != covered.right).any(2)
        assert not covered.noc[different].any()
        assert covered.noc.mean() > 0.6
        hidden += different.any()
    assert 5 < apart < 20  # some pairs keep equal cameras
    assert hidden == 20


@pytest.mark.parametrize("crop", [(64, 64), (64, 83), (256, 64)])
def test_small_crops_are_occluded_too(rendered: RenderedSample, crop: tuple[int, int]) -> None:
    for seed in range(10):
        changed = augment(rendered, crop, np.random.default_rng(seed), occluders=1)
        assert changed.left.shape == (*crop, 3)


def test_input_is_not_changed(rendered: RenderedSample) -> None:
    before = rendered.left.copy(), rendered.right.copy(), rendered.disparity.copy()
    for seed in range(6):
        augment(rendered, rendered.disparity.shape, np.random.default_rng(seed), scales=(1, 1), occluders=1)
    for old, new in zip(before, (rendered.left, rendered.right, rendered.disparity), strict=True):
        assert np.array_equal(old, new)


def test_same_dice_same_pair(rendered: RenderedSample) -> None:
    a, b, c = (augment(rendered, CROP, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(a.left, b.left)
    assert np.array_equal(a.disparity, b.disparity)
    assert not np.array_equal(a.left, c.left)


def test_crop_larger_than_the_pair(rendered: RenderedSample) -> None:
    with pytest.raises(AnyNetError, match="a crop of 300 x 100 does not fit in 256 x 512 pixels"):
        random_crop(rendered, (300, 100), np.random.default_rng(0))
    grown = augment(rendered, (300, 600), np.random.default_rng(0))
    assert grown.left.shape == (300, 600, 3)
    with pytest.raises(AnyNetError, match=r"a crop of 300 x 900 does not fit in 256 x 512 pixels, enlarged by .* 1\.6"):
        augment(rendered, (300, 900), np.random.default_rng(0))
