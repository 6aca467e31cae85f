from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData

from anynet.io import read_image, write_disparity
from anynet.synthetic import render

from .conftest import Run


def rows(table: str) -> list[list[float]]:
    """The numbers of the table, one row per stage."""
    return [[float(number) for number in re.findall(r"[\d.]+", line)] for line in table.splitlines() if "│" in line]


def test_motorcycle(run: Run, weights: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run("demo", "--out", out, "--weights", weights)
    assert (result.status, result.err) == (0, "")
    assert "Motorcycle, 741 x 500" in result.out
    table = rows(result.out)
    assert [row[0] for row in table] == [1, 2, 3, 4]
    assert all(len(row) == 5 for row in table)
    assert [row[1] for row in table] == sorted(row[1] for row in table)
    assert result.out.splitlines()[-2:] == [str(out / "stages.png"), str(out / "cloud.ply")]
    assert read_image(out / "stages.png").shape[0] > 4 * 500  # four rows of panels
    assert len(PlyData.read(out / "cloud.ply")["vertex"].data) > 0


def test_rendered_scene(run: Run, weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anynet.synthetic.render", partial(render, height=96, width=160))  # in a tenth of the time
    result = run("demo", "--rendered", "--seed", 3, "--out", tmp_path, "--weights", weights)
    assert (result.status, result.err) == (0, "")
    assert all(len(row) == 5 for row in rows(result.out))
    assert [path.name for path in tmp_path.iterdir()] == ["stages.png"]


def test_a_pair_of_ones_own(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    out, truth, calib = tmp_path / "out", tmp_path / "truth.pfm", tmp_path / "calib.txt"
    write_disparity(truth, np.full((48, 64), 4, np.float32))
    calib.write_text("cam0=[100 0 30; 0 100 20; 0 0 1]\ndoffs=30\nbaseline=200\n")
    result = run("demo", *pair, "--out", out, "--weights", weights)
    assert (result.status, result.err) == (0, "")
    assert all(len(row) == 2 for row in rows(result.out))
    assert [path.name for path in out.iterdir()] == ["stages.png"]
    result = run("demo", *pair, "--truth", truth, "--calib", calib, "--out", out, "--weights", weights)
    assert (result.status, result.err) == (0, "")
    assert all(len(row) == 5 for row in rows(result.out))
    assert (out / "cloud.ply").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["left.png"], "expected two images or none"),
        (["left.png", "right.png", "--rendered"], "exclude each other"),
        (["--truth", "truth.pfm"], "belong to a pair of images"),
        (["--truth-scale", "4"], "--truth-scale belongs to --truth"),
        (["left.png", "right.png", "--truth-scale", "4"], "--truth-scale belongs to --truth"),
        (["--seed", "0"], "--seed belongs to --rendered"),
        (["none.png", "none.png"], "cannot read none.png"),
    ],
)
def test_mistakes(run: Run, weights: Path, tmp_path: Path, arguments: list[str], message: str) -> None:
    result = run("demo", *arguments, "--out", tmp_path / "out", "--weights", weights)
    assert result.status == 2
    assert result.err.startswith("anynet: ")
    assert result.err.count("\n") == 1
    assert message in result.err
    assert not (tmp_path / "out").exists()


def test_no_image_to_read_is_overwritten(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    left = pair[0].rename(tmp_path / "stages.png")
    result = run("demo", left, pair[1], "--out", tmp_path, "--weights", weights)
    assert (result.status, result.out) == (2, "")
    assert result.err == f"anynet: {left}: is one of the files to read; choose another folder for the results\n"


def test_an_output_folder_that_cannot_be_made(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = run("demo", *pair, "--out", tmp_path / "file", "--weights", "none")  # told before the weights are opened
    assert (result.status, result.err) == (2, f"anynet: cannot make the folder {tmp_path / 'file'}: File exists\n")


def test_a_truth_of_another_size(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    write_disparity(tmp_path / "truth.npy", np.zeros((2, 3), np.float32))
    result = run("demo", *pair, "--truth", tmp_path / "truth.npy", "--weights", weights, "--out", tmp_path / "out")
    assert result.status == 2
    assert "expected a disparity map of 64 x 48, got (3, 2)" in result.err
