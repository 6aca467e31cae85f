"""`predict` with confidence: files, holes in maps and clouds, where the cloud ends."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData

from anynet.io import read_image

from .conftest import Run

CALIB = ("--focal", 100, "--baseline", 0.1)


def read(run: Run, pair: tuple[Path, Path], out: Path, *options: object) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Disparity, the cloud's depths, and the kinds of files."""
    result = run("predict", *pair, "--out", out, "--format", "npy", "--no-check", "--json", *CALIB, *options)
    assert result.status == 0, result.err
    depths = PlyData.read(str(out / "left_cloud.ply"))["vertex"]["z"]
    return np.load(out / "left_disparity.npy"), depths, sorted(json.loads(result.out)["files"])


def test_files(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    _, _, plain = read(run, pair, tmp_path / "plain")
    assert "confidence" not in plain
    for option in ("--confidence", "--left-right"):
        disparity, _, files = read(run, pair, tmp_path / option, option)
        assert {"confidence", "occluded"} == set(files) - set(plain)
        assert np.isfinite(disparity).mean() > 0.9
        picture = read_image(tmp_path / option / "left_confidence.png")
        assert picture.shape == (*disparity.shape, 3)
        assert set(np.unique(read_image(tmp_path / option / "left_occluded.png"))) <= {0, 255}


def test_holes(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    disparity, depths, _ = read(run, pair, tmp_path / "all", "--confidence", "--max-depth", "inf")
    confidence = read_image(tmp_path / "all" / "left_confidence.png")[..., 0] / 255
    least = float(np.median(confidence))
    kept, fewer, _ = read(run, pair, tmp_path / "sure", "--min-confidence", least, "--max-depth", "inf")
    clear = np.abs(confidence - least) > 0.01
    np.testing.assert_array_equal(np.isfinite(kept)[clear], (np.isfinite(disparity) & (confidence > least))[clear])
    assert len(fewer) == np.isfinite(kept).sum() < len(depths)
    seen, _, _ = read(run, pair, tmp_path / "seen", "--drop-occluded")
    occluded = read_image(tmp_path / "seen" / "left_occluded.png")[..., 0] > 0
    assert np.isnan(seen[occluded]).all()


def test_the_cloud_ends(run: Run, pair: tuple[Path, Path], tmp_path: Path) -> None:
    _, depths, _ = read(run, pair, tmp_path / "default")
    assert depths.max() <= 100 * 0.1 / 2.5 * 1.001
    middle = float(np.median(depths))
    _, near, _ = read(run, pair, tmp_path / "near", "--max-depth", middle)
    assert 0 < len(near) < len(depths)
    assert near.max() <= middle


@pytest.mark.parametrize("options", [("--min-confidence", 1.5), ("--min-confidence", "x"), ("--max-depth", 0)])
def test_wrong_options(run: Run, pair: tuple[Path, Path], tmp_path: Path, options: tuple[object, ...]) -> None:
    result = run("predict", *pair, "--out", tmp_path / "out", *options)
    assert result.status == 2
    assert str(options[0]) in result.err
