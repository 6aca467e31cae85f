"""A trivial data set, and training runs on it as processes of their own: planes.py OUT OPTIONS (JSON)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from anynet.data import StereoSample
from anynet.training.batches import batches
from anynet.training.distributed import Processes
from anynet.training.loop import _Run, train
from anynet.training.recipe import Recipe
from anynet.training.run_folder import LOG

SMALL: dict[str, Any] = {
    "batch_size": 4,
    "crop_size": (64, 128),
    "augment": False,
    "steps": 12,
    "checkpoint_every": 2,
    "log_every": 1,
    "threads": 1,
}

RECIPE = Recipe(**SMALL, workers=0)


class Planes(Sequence[StereoSample]):
    """Blocks of noise, one disparity each; some rows are unknown, as many as differ from image to image."""

    def __init__(self, count: int, height: int = 80, width: int = 144) -> None:
        self._count, self._size = count, (height, width)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> StereoSample:  # type: ignore[override]
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


def log_lines(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / LOG).read_text().splitlines()]


def begun(out: Path, device: str = "cpu", **options: Any) -> tuple[_Run, list[Tensor]]:
    """A run of small batches, and the first of them."""
    recipe, group = replace(RECIPE, batch_size=2, **options), Processes(0, 1, torch.device(device))
    batch = next(batches(Planes(10), recipe, range(1), Processes(0, 1, torch.device("cpu"))))
    return _Run(recipe, out, Planes(10), {}, group), batch


def start(out: Path, launcher: tuple[str, ...] = (), **options: Any) -> subprocess.Popen[str]:
    """A process that trains in the folder `out`, with these options besides SMALL."""
    command = [sys.executable, *launcher, __file__, str(out), json.dumps(options)]
    path = os.pathsep.join(p for p in sys.path if p)
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str]) -> None:
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors


if __name__ == "__main__":
    torch.set_default_dtype(torch.float64)  # so that runs that should be equal do not differ by rounding
    options = {**SMALL, **json.loads(sys.argv[2])}
    recipe = Recipe(**{name: tuple(v) if isinstance(v, list) else v for name, v in options.items()})
    train(recipe, sys.argv[1], resume=True, data=Planes(10))
