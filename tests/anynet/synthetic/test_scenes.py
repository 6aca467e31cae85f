from __future__ import annotations

import numpy as np
import pytest

from anynet.synthetic.renderer import draw
from anynet.synthetic.scenes import PRESETS


@pytest.mark.parametrize("preset", PRESETS)
def test_scenes_leave_no_gaps(preset: str) -> None:
    """Whatever the seed, something is behind every pixel of both views."""
    for seed in range(3):
        scene = PRESETS[preset](np.random.default_rng(seed), 96, 160)
        assert len(scene.surfaces) > 5
        for view in (0, 1):
            image, disparity = draw(scene, view)
            assert (disparity > 0).mean() > 0.995
            assert image.std() > 5
            assert disparity.max() < 400
