"""A bank of textures, cut-out shapes and reliefs, generated once per process and then reused.

Every entry has its own fixed seed, so a scene depends on the scene's seed alone.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import cv2
import numpy as np

from anynet.synthetic.textures.fields import Field, Image, octaves
from anynet.synthetic.textures.patterns import PATTERNS
from anynet.synthetic.textures.shapes import SHAPES, car

VARIANTS = 20  # entries per kind


def _pyramid(image: Image) -> tuple[Image, ...]:
    levels = [image]
    while levels[-1].shape[0] > 6:
        levels.append(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.uint8))
    return tuple(levels)


@functools.cache
def texture(kind: str, variant: int) -> Sequence[Image]:
    """Mip pyramid of one texture, uint8 [size, size, 3], finest level first."""
    return _pyramid(PATTERNS[kind](np.random.default_rng([list(PATTERNS).index(kind), variant])))


@functools.cache
def shape(kind: str, variant: int) -> Sequence[Image]:
    """Mip pyramid of one cut-out shape, uint8 [size, size], 255 inside."""
    if kind in ("car", "car glass"):
        return _pyramid(car(variant, kind == "car glass"))
    return _pyramid(SHAPES[kind](np.random.default_rng([100 + list(SHAPES).index(kind), variant])))


@functools.cache
def relief(variant: int) -> tuple[Field, Image]:
    """A height field [64, 64] in [-1, 1] and the brightness (uint8, 128 = unchanged) a slanted light gives it."""
    rng = np.random.default_rng([200, variant])
    roughness = rng.uniform(0.15, 0.5)
    size = 64
    height = 2 * octaves(rng, 256, roughness, stretch=((1, 1), (3, 1), (1, 3))[variant % 3])[::4, ::4] - 1
    height = cv2.GaussianBlur(height, (0, 0), 1.2).astype(np.float32)
    slope = cv2.Sobel(height, cv2.CV_32F, 1, 0) + cv2.Sobel(height, cv2.CV_32F, 0, 1)
    shade = np.clip(128 * (1 + rng.uniform(0.2, 0.7) * slope / (3 * slope.std())), 30, 255).astype(np.uint8)
    assert height.shape == (size, size)
    return height, shade
