"""Where and how to compute, as the commands are told it."""

from __future__ import annotations

from pathlib import Path

import pytest

from anynet.cli import main


@pytest.mark.parametrize("command", ["predict", "demo", "stream", "evaluate", "view"])
def test_half_precision_on_the_cpu_is_refused(
    folders: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    images = [str(folder / "a.png") for folder in folders]
    given = ["--data", "render:1"] if command == "evaluate" else [*images, "--out", str(tmp_path / "out")]
    assert main([command, *given, "--precision", "float16"]) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert line == "anynet: precision 'float16' is for a GPU: expected 'float32' on the CPU"
