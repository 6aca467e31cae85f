from __future__ import annotations

import numpy as np

from anynet.synthetic.sensor import photograph


def pair(height: int = 96, width: int = 160) -> np.ndarray:
    texture = np.random.default_rng(0).integers(30, 220, (height // 8, width // 8, 3), np.uint8)
    return texture.repeat(8, 0).repeat(8, 1)


def test_same_generator_same_images() -> None:
    scene = pair()
    one, two, other = (photograph(np.random.default_rng(seed), scene, scene) for seed in (3, 3, 4))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a, b)
    assert not np.array_equal(one[0], other[0])


def test_noise_differs_between_the_views_but_not_what_is_seen() -> None:
    scene = pair()
    for seed in range(10):
        left, right = photograph(np.random.default_rng(seed), scene, scene)
        assert left.shape == right.shape == scene.shape
        assert left.dtype == right.dtype == np.uint8
        assert not np.array_equal(left, right)
        gray = [image.mean(2).ravel() for image in (left, right)]
        assert np.corrcoef(gray[0], gray[1])[0, 1] > 0.8


def test_images_larger_than_the_stored_noise() -> None:
    scene = pair(1032, 1544)
    left, _ = photograph(np.random.default_rng(0), scene, scene)
    assert left.shape == scene.shape
