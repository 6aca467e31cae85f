"""Objects leave gaps where they should, and stand where they are put."""

from __future__ import annotations

import numpy as np
import pytest

from anynet.synthetic import objects
from anynet.synthetic.geometry import Camera
from anynet.synthetic.renderer import draw
from anynet.synthetic.scene import Scene

CAMERA = Camera(192, 128, 200.0, 96.0, 64.0)


def add(kind: str, scene: Scene, foot: np.ndarray, size: float) -> None:
    function = getattr(objects, kind)
    extra = {"bush": (size, size, 2), "car": (0.3, size / 10), "sign": (size / 5,), "thing": (size, True)}
    function(scene, foot, *extra.get(kind, (size,)))


@pytest.mark.parametrize("kind", objects.__all__)
def test_an_object_is_drawn_where_it_stands(kind: str) -> None:
    """Before a wall at disparity 4, an object 10 baselines away, of disparity 20 by and large."""
    shares = []
    for seed in range(6):
        scene = Scene(np.random.default_rng(seed), CAMERA)
        scene.card(np.array([0, 0, 50.0]), 200.0, 200.0, np.eye(3), scene.material(("noise",), 5.0), None)
        add(kind, scene, np.array([0, 1.5, 10.0]), 3.0)
        disparity = draw(scene, 0)[1]
        near = disparity > 5
        shares.append(near.mean())
        if near.any():
            assert 12 < np.median(disparity[near]) < 40
            assert near[:, 30:165].sum() > 0.9 * near.sum()
    assert max(shares) > 0.005
    assert max(shares) < 0.5


@pytest.mark.parametrize("kind", ["machine", "slats", "shelf"])
def test_one_sees_through_what_has_gaps(kind: str) -> None:
    """In most of many tries, some row meets the thing, what is behind it, and the thing again."""
    gaps = 0
    for seed in range(12):
        scene = Scene(np.random.default_rng(seed), CAMERA)
        scene.card(np.array([0, 0, 20.0]), 60.0, 60.0, np.eye(3), scene.material(("noise",), 5.0), None)
        add(kind, scene, np.array([0, 2.5, 5.0]), 4.0)
        disparity = draw(scene, 0)[1]
        near = disparity > 20
        assert 0.02 < near.mean() < 1
        assert disparity[~near].max() == pytest.approx(10, abs=0.01)
        gaps += (np.diff(near.astype(int), axis=1) == 1).sum(1).max() > 1
    assert gaps >= 6
