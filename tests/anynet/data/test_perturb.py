from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from anynet.data.augment import augment
from anynet.data.perturb import PERTURBATIONS, as_by_a_rig, blurred, compressed, exposed, lowered, noisy
from anynet.samples import StereoSample
from anynet.synthetic import render


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return render(3, 128, 256, preset="things", sensor=False).left


def test_lowered_moves_rows_down(image: np.ndarray) -> None:
    assert np.array_equal(lowered(image, 2)[2:], image[:-2])
    assert np.array_equal(lowered(image, 2)[0], image[0])


def test_a_turn_is_clockwise_about_the_center() -> None:
    image = np.zeros((101, 201, 3), np.uint8)
    image[50, 150] = 255
    rolled, sheared = lowered(image, 0, 10), lowered(image, 0, 10, rolled=False)
    y, x = np.unravel_index(rolled[..., 0].argmax(), (101, 201))
    assert (y, x) == (50 + round(50 * np.sin(np.radians(10))), 100 + round(50 * np.cos(np.radians(10))))
    y, x = np.unravel_index(sheared[..., 0].argmax(), (101, 201))
    assert (y, x) == (50 + round(50 * np.sin(np.radians(10))), 150)  # no column moves


def test_exposure() -> None:
    ramp = np.arange(256, dtype=np.uint8).reshape(1, 256, 1).repeat(3, 2)
    assert np.array_equal(exposed(ramp, 1), ramp)
    assert np.abs(exposed(ramp, 0.5).astype(int) - ramp / 2).max() <= 0.5
    assert exposed(ramp, 3)[0, 100, 0] == 255
    assert exposed(ramp, 1, 2)[0, 128, 0] == round(255 * (128 / 255) ** 2)


def test_noise_blur_and_compression(image: np.ndarray) -> None:
    gray = np.full((200, 200, 3), 128, np.uint8)
    noise = noisy(gray, 2, np.random.default_rng(0)).astype(float) - 128
    assert np.abs(noise.std((0, 1)) - 2).max() < 0.05
    assert np.abs(noise.mean((0, 1))).max() < 0.05
    assert noisy(gray + 127, 1, np.random.default_rng(0)).min() > 245  # 255 is the most
    assert blurred(image, 1).std() < image.std()
    losses = [np.abs(compressed(image, quality).astype(int) - image).mean() for quality in (95, 30)]
    assert 0 < losses[0] < losses[1]


def test_compression_is_that_of_other_programs(image: np.ndarray) -> None:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=30)
    apart = np.abs(compressed(image, 30).astype(int) - np.asarray(Image.open(file)))
    assert apart.mean() < 1  # with red and blue exchanged, 3.4


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_each_changes_the_pair_repeatably_and_leaves_the_input(name: str, image: np.ndarray) -> None:
    left, right = image, image[:, ::-1].copy()
    kept = left.copy(), right.copy()
    first, second = (PERTURBATIONS[name](left, right, np.random.default_rng(1)) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    assert all(view.shape == image.shape and view.dtype == np.uint8 for view in first)
    assert not np.array_equal(first[1], right)
    assert np.array_equal(left, kept[0])
    assert np.array_equal(right, kept[1])


def test_training_sees_all_kinds_and_clean_pairs(image: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    pairs = [as_by_a_rig(image, image, rng) for _ in range(60)]
    changed = [(not np.array_equal(left, image), not np.array_equal(right, image)) for left, right in pairs]
    assert len(set(changed)) == 4


def test_augment_perturbs_only_when_asked(image: np.ndarray) -> None:
    flat = np.full(image.shape[:2], 10, np.float32)
    sample = StereoSample(image, image, flat, np.ones_like(flat, bool))

    def views(seed: int, perturb: bool) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        out = augment(sample, (64, 128), rng, scales=(1, 1), photometric=False, occluders=0, perturb=perturb)
        return out.left, out.right

    assert all(np.array_equal(*views(seed, False)) for seed in range(10))
    assert not all(np.array_equal(*views(seed, True)) for seed in range(10))
