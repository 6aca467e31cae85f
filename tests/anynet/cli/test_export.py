from __future__ import annotations

from pathlib import Path

import torch

from .conftest import Run


def test_a_program(run: Run, weights: Path, tmp_path: Path) -> None:
    out = tmp_path / "made" / "network.pt2"
    size = ("--height", 40, "--width", 56)
    result = run("export", "--format", "pt2", "--weights", weights, *size, "--stages", 2, "--out", out)
    assert (result.status, result.out, result.err) == (0, f"{out}\n", "")
    images = torch.randint(0, 256, (2, 40, 56, 3), dtype=torch.uint8)
    assert [disparity.shape for disparity in torch.export.load(out).module()(*images)] == [(40, 56)] * 2


def test_mistakes_are_told(run: Run, tmp_path: Path) -> None:
    size = ("--height", 40, "--width", 56)
    result = run("export", "--format", "pt2", *size, "--out", tmp_path)
    assert (result.status, result.err) == (2, f"anynet: {tmp_path}: expected the name of a file, got a folder\n")
    result = run("export", "--format", "onnx", *size, "--dynamic", "--out", tmp_path / "network.onnx")
    assert result.status == 2
    assert result.err == "anynet: export: expected images of one size for onnx, got dynamic, which pt2 alone can be\n"
