from __future__ import annotations

import numpy as np
import pytest

from anynet.synthetic import textures
from anynet.synthetic.geometry import Camera, Window
from anynet.synthetic.materials import Material, level_matrix, mip_level

CAMERA = Camera(96, 64, 100.0, 48.0, 32.0)
WHOLE = Window(0, 0, 96, 64)


def test_light_scales_the_tone_curve() -> None:
    gray = np.full((64, 96, 3), 100, np.uint8)
    plain = Material("plain", 0)
    assert (plain.finish(gray, WHOLE, CAMERA, 0) == 100).all()
    assert (plain.lit(0.5).finish(gray, WHOLE, CAMERA, 0) == 50).all()
    assert (plain.lit(0.5).lit(2.0).finish(gray, WHOLE, CAMERA, 0) == 100).all()
    assert (plain.lit(9.0).finish(gray, WHOLE, CAMERA, 0) == 255).all()


def test_gloss_mirrors_what_is_elsewhere_for_the_other_view() -> None:
    gray = np.full((64, 96, 3), 100, np.uint8)
    glossy = Material("plain", 0, gloss=0.5, environment=3)
    left, right = (glossy.finish(gray, WHOLE, CAMERA, view) for view in (0, 1))
    assert left.std() > 0
    assert not np.array_equal(left, right)


@pytest.mark.parametrize("turn", [False, True])
def test_placement_keeps_small_surfaces_inside_one_tile(turn: bool) -> None:
    material = Material("plain", 0, tile=2.0, offset=(0.9, 0.9), turn=turn)
    place = material.placement(1.0, 0.5)
    corners = place @ np.array([[0, 1, 0, 1], [0, 0, 1, 1], [1, 1, 1, 1.0]])
    assert corners[:2].min() >= 0
    assert corners[:2].max() <= textures.SIZE
    sides = np.ptp(corners[:2], axis=1)
    np.testing.assert_allclose(sides, (textures.SIZE / 4, textures.SIZE / 2) if turn else (192, 96))


def test_levels_of_the_pyramid() -> None:
    pyramid = textures.texture("noise", 0)
    assert [mip_level(pyramid, scale) for scale in (0, 0.5, 1, 2, 4, 1e9)] == [0, 0, 0, 1, 2, len(pyramid) - 1]
    # Four texels around (0.5, 0.5) become the one at the origin.
    np.testing.assert_allclose(level_matrix(1) @ [0.5, 0.5, 1], [0, 0, 1])
