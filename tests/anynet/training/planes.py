"""A trivial data set, and a training run on it to be started as a process of its own: planes.py OUT OPTIONS (JSON)."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

import numpy as np
import torch

from anynet.data import StereoSample
from anynet.training.loop import train
from anynet.training.recipe import Recipe

SMALL = {
    "batch_size": 4,
    "crop_size": (64, 128),
    "augment": False,
    "steps": 12,
    "checkpoint_every": 2,
    "log_every": 1,
    "threads": 1,
}


class Planes(Sequence[StereoSample]):
    """Blocks of noise, one disparity each; some rows are unknown, as many as differ from image to image."""

    def __init__(self, count: int, height: int = 80, width: int = 144) -> None:
        self._count, self._size = count, (height, width)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index):
        if not 0 <= index < self._count:
            raise IndexError(index)
        rng = np.random.default_rng(index)
        height, width = self._size
        shift = int(rng.integers(1, 24))
        scene = rng.integers(0, 256, (height // 4, (width + 24) // 4, 3), np.uint8).repeat(4, 0).repeat(4, 1)
        disparity = np.full((height, width), shift, np.float32)
        valid = np.ones((height, width), bool)
        valid[: 10 * (index % 5)] = False
        return StereoSample(scene[:, :width], scene[:, shift : shift + width], disparity, valid, name=f"plane {index}")


if __name__ == "__main__":
    torch.set_default_dtype(torch.float64)  # so that runs that should be equal do not differ by rounding
    options = {**SMALL, **json.loads(sys.argv[2])}
    recipe = Recipe(**{name: tuple(v) if isinstance(v, list) else v for name, v in options.items()})
    train(recipe, sys.argv[1], resume=True, data=Planes(10))
