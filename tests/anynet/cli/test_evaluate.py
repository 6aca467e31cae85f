from __future__ import annotations

import json
from pathlib import Path

import pytest

from anynet import AnyNet, save_checkpoint
from anynet.cli import main


def test_tables_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights = tmp_path / "weights.safetensors"
    save_checkpoint(weights, AnyNet(), {})
    data = "render:2?height=64&width=128"
    out = tmp_path / "out"
    assert main(["evaluate", "--weights", str(weights), "--method", "bm", "--data", data, "--out", str(out)]) == 0
    table = capsys.readouterr().out
    assert table == (out / "results.md").read_text()
    assert table.count(f"| {weights} | {data} | all | 2 |") == 4
    assert table.count("| OpenCV BM |") == 1
    network, matcher = json.loads((out / "results.json").read_text())
    assert len(network["stages"]) == 4
    assert len(network["stages"][3]["images"]) == 2
    assert matcher["stages"][0]["density"] < 100
    assert sorted(path.name for path in out.glob("*.png")) == ["0.png", "1.png"]


def test_every_split_wants_data(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--splits", "--method", "bm", "--data", "render:1", "--data", "render:1"]) == 2
    assert "as many weights as data; got 1, 1, 2" in capsys.readouterr().err
