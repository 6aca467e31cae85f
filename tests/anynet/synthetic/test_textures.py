from __future__ import annotations

import numpy as np
import pytest

from anynet.synthetic import textures
from anynet.synthetic.textures.patterns import PATTERNS
from anynet.synthetic.textures.shapes import SHAPES


@pytest.mark.parametrize("kind", PATTERNS)
def test_textures(kind: str) -> None:
    first, second = (textures.texture(kind, variant) for variant in (0, 1))
    assert first[0].shape == (textures.SIZE, textures.SIZE, 3)
    assert first[0].dtype == np.uint8
    assert not np.array_equal(first[0], second[0])
    assert len(np.unique(first[0].reshape(-1, 3), axis=0)) > 5
    sides = [level.shape[0] for level in first]
    assert sides == [textures.SIZE >> level for level in range(len(sides))]
    assert abs(first[-1].mean() - first[0].mean()) < 3  # smaller levels are as bright


@pytest.mark.parametrize("kind", [*SHAPES, "car", "car glass"])
def test_shapes(kind: str) -> None:
    shape = textures.shape(kind, 0)[0]
    assert shape.shape == (textures.SHAPE_SIZE, textures.SHAPE_SIZE)
    assert 0.01 < (shape > 127).mean() < 0.99


def test_the_bank_is_the_same_in_every_process() -> None:
    generator = np.random.default_rng([list(PATTERNS).index("wood"), 4])
    np.testing.assert_array_equal(textures.texture("wood", 4)[0], PATTERNS["wood"](generator))


def test_reliefs() -> None:
    height, shade = textures.relief(2)
    assert height.shape == shade.shape == (64, 64)
    assert -1 <= height.min() < -0.3
    assert 0.3 < height.max() <= 1
    assert shade.std() > 5
