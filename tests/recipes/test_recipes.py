"""Every recipe makes weights, here from a few pairs and steps, and goes on after an interruption."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from anynet import load_checkpoint, save_checkpoint
from anynet.checkpoint import load_metadata
from anynet.data.rendered import write_rendered
from anynet.io import write_image
from anynet.model import presets

RECIPES = Path(__file__).parents[2] / "recipes"
NETWORKS = {
    "default": presets.default(),
    "kitti": presets.large().with_input_scale(2),
    "large": presets.large().with_input_scale(2),
    "paper": presets.filled(),
}
KITTI = RECIPES.parent / ".." / "shared" / "data" / "kitti2015"


def test_average(tmp_path: Path) -> None:
    files = []
    for number in (1, 3):
        model = load_checkpoint("paper")
        with torch.no_grad():
            for parameter in model.parameters():
                parameter.fill_(number)
        files.append(tmp_path / f"{number}.safetensors")
        save_checkpoint(files[-1], model, {"number": number})
    out = tmp_path / "out.safetensors"
    subprocess.run([sys.executable, str(RECIPES / "average.py"), out, *files], check=True)
    assert all(parameter.eq(2).all() for parameter in load_checkpoint(out).parameters())
    assert load_metadata(out) == {"mean_of": [{"number": 1}, {"number": 3}]}


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["average.py"], "expected OUT and files of weights, got nothing"),
        (["average.py", "out.safetensors"], "expected OUT and files of weights, got out.safetensors"),
        (["average.py", "out.safetensors", "paper", "large"], "expected weights of the network of paper, got large's"),
        (["average.py", "out.safetensors", "nowhere"], "expected a file of weights or a packaged name"),
        (
            ["confidence.py", "--weights", "half.safetensors", "--rendered", "none", "--real", "render:1"],
            "half.safetensors: expected an input_scale of 1 or 2, got 0.5",
        ),
        (
            ["confidence.py", "--rendered", "none", "--real", "render:1", "--per-pair", "0"],
            "--per-pair: expected at least 1 pixel, got 0",
        ),
        (
            ["confidence.py", "--weights", "own.safetensors", "--rendered", "rendered", "--real", "csv:pairs.csv"],
            "csv:pairs.csv: expected pairs with known disparities that count, got none; left: no known disparity",
        ),
    ],
)
def test_mistakes_are_told_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    command: list[str],
    message: str,
) -> None:
    if "half.safetensors" in command:
        save_checkpoint(tmp_path / "half.safetensors", load_checkpoint("paper", 0.5))
    if "own.safetensors" in command:
        save_checkpoint(tmp_path / "own.safetensors", load_checkpoint("paper"))
        list(write_rendered(tmp_path / "rendered", 1, height=96, width=128))
        for side in ("left", "right"):
            write_image(tmp_path / f"{side}.png", np.zeros((96, 128, 3), np.uint8))
        (tmp_path / "pairs.csv").write_text("left,right\nleft.png,right.png\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(RECIPES / command[0]), run_name="__main__")
    assert isinstance(end.value.code, str)  # which Python writes to stderr, with exit status 1
    (line,) = end.value.code.splitlines()
    assert line.startswith(message)
    assert capsys.readouterr().err == ""
    assert not list(tmp_path.glob("*.confidence.json"))


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
        "PYTHON": sys.executable,
    }
    for _ in range(2):  # the second time, nothing is left to do
        subprocess.run([str(script), str(tmp_path / "out")], env=environment, check=True, timeout=600)
        weights = tmp_path / "out" / script.stem / "weights.safetensors"
        assert load_checkpoint(weights).config == NETWORKS[script.stem]
