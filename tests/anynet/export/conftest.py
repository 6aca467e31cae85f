from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from networks import wild

from anynet import save_checkpoint
from anynet.model import presets
from anynet.synthetic import render

from .cases import Pair


@pytest.fixture(scope="session")
def pair() -> Pair:
    """Of sizes that no power of two divides."""
    scene = render(0)
    return Pair(*(np.ascontiguousarray(image[:83, :141]) for image in (scene.left, scene.right)))


@pytest.fixture(scope="session")
def small_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "small.safetensors"
    save_checkpoint(path, wild(presets.filled().with_options({"first_stage.channels": 4})))
    return path
