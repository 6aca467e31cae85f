"""Mistakes in what examples/ray_predict.py is given; Ray is not needed for them."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "ray_predict.py"


@pytest.mark.parametrize(
    ("content", "arguments", "message"),
    [
        (None, (), "pairs.csv: No such file or directory"),
        ("left,right\na.png\n", (), "expected a CSV file with columns left and right, both in every row"),
        ("left,right\na.png,\n", (), "expected a CSV file with columns left and right, both in every row"),
        ("left,right\na.png,b.png\n", ("--batch", "0"), "argument --batch: invalid count value: '0'"),
        ("folder", (), "Is a directory"),
    ],
)
def test_mistakes_are_told(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    content: str | None,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    path = tmp_path / "pairs.csv"
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_text(content)
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), "--list", str(path), "--out", str(tmp_path / "out"), *arguments])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert end.value.code == 2
    errors = capsys.readouterr().err
    assert errors.splitlines()[-1].endswith(message)
    assert "Traceback" not in errors
