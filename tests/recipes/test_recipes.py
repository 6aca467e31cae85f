"""Every recipe makes weights, here from a few pairs and steps, and goes on after an interruption."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from anynet import load_checkpoint
from anynet.model import presets

RECIPES = Path(__file__).parents[2] / "recipes"
NETWORKS = {
    "default": presets.default(),
    "kitti": presets.large().with_input_scale(2),
    "large": presets.large().with_input_scale(2),
    "paper": presets.filled(),
}
KITTI = RECIPES.parent / ".." / "shared" / "data" / "kitti2015"


@pytest.mark.slow
@pytest.mark.timeout(1300)
@pytest.mark.parametrize("script", sorted(RECIPES.glob("*.sh")), ids=lambda script: script.stem)
def test_a_recipe_makes_weights(script: Path, tmp_path: Path) -> None:
    if script.stem == "kitti" and not KITTI.exists():
        pytest.skip("the KITTI pairs are not in ../shared/data")
    commands = tmp_path / "bin"
    commands.mkdir()
    anynet = commands / "anynet"
    anynet.write_text(f'#!/bin/sh\nexec {sys.executable} -m anynet "$@"\n')
    anynet.chmod(0o755)
    environment = os.environ | {
        "PATH": f"{commands}:{os.environ['PATH']}",
        "PAIRS": "4",
        "STEPS": "3",
        "KITTI": str(KITTI),
    }
    for _ in range(2):  # the second time, nothing is left to do
        subprocess.run([str(script), str(tmp_path / "out")], env=environment, check=True, timeout=600)
        weights = tmp_path / "out" / script.stem / "weights.safetensors"
        assert load_checkpoint(weights).config == NETWORKS[script.stem]
