from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from anynet import Predictor
from anynet.io import read_disparity, read_pair, write_image

pytest.importorskip("ray", reason="the extra `ray` is not installed")
parquet = pytest.importorskip("pyarrow.parquet")

EXAMPLE = Path(__file__).parents[2] / "examples" / "ray_predict.py"
PAIRS = 24
# For a machine that others keep busy: workers are no "nicer" than the rest, and the head may take its time.
PATIENCE = {"RAY_worker_niceness": "0", "RAY_gcs_server_port_wait_time_s": "300"}


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Pairs of noise, and one that cannot be read."""
    random = np.random.default_rng(0)
    sides = tmp_path / "left", tmp_path / "right"
    for side in sides:
        side.mkdir()
        for i in range(PAIRS):
            write_image(side / f"{i:02d}.png", random.integers(0, 256, (48, 64, 3), dtype=np.uint8))
        (side / "bad.png").write_bytes(b"no image")
    return sides


def start(*arguments: object) -> subprocess.Popen[str]:
    path = os.pathsep.join(p for p in sys.path if p)
    command = [sys.executable, str(EXAMPLE), *map(str, arguments), "--actors", "2", "--batch", "1"]
    environment = {**os.environ, **PATIENCE, "PYTHONPATH": path, "RAY_DATA_DISABLE_PROGRESS_BARS": "1"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_killed_worker_a_bad_pair_and_going_on(folders: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = start(*folders, "--out", out)
    while not (out.exists() and any(out.glob("*.pfm"))):
        assert process.poll() is None, process.communicate()
        time.sleep(0.1)
    workers = [p for p in psutil.Process(process.pid).children(recursive=True) if "MapWorker" in " ".join(p.cmdline())]
    assert len(workers) == 2
    workers[0].kill()
    told, errors = process.communicate()
    assert process.returncode == 2, errors
    assert told.splitlines()[0] == f"{PAIRS + 1} pairs, {PAIRS + 1} to do"
    assert f"{PAIRS} done, 1 failed" in told.splitlines()  # Ray writes there, too
    assert "ray_predict: bad: " in errors
    predictor = Predictor(threads=1)
    for i in range(PAIRS):
        expected = predictor.predict(*read_pair(*(side / f"{i:02d}.png" for side in folders))).disparity
        np.testing.assert_array_equal(read_disparity(out / f"{i:02d}.pfm"), expected)
    (out / "03.pfm").unlink()
    for side in folders:
        (side / "bad.png").unlink()
    told, errors = (again := start(*folders, "--out", out)).communicate()
    assert again.returncode == 0, errors
    assert told.splitlines()[0] == f"{PAIRS} pairs, 1 to do"
    assert (out / "03.pfm").exists()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_list_to_parquet(folders: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "pairs.csv").write_text("left,right\nleft/00.png,right/00.png\nleft/01.png,right/01.png\n")
    arguments = "--list", tmp_path / "pairs.csv", "--out", tmp_path / "out", "--format", "parquet"
    _, errors = (process := start(*arguments)).communicate()
    assert process.returncode == 0, errors
    rows = [
        row for file in sorted((tmp_path / "out").glob("*.parquet")) for row in parquet.read_table(file).to_pylist()
    ]
    assert sorted(row["name"] for row in rows) == ["00000000_00", "00000001_01"]
    for row in rows:
        images = read_pair(*(side / f"{row['name'][-2:]}.png" for side in folders))
        expected = Predictor(threads=1).predict(*images).disparity
        np.testing.assert_array_equal(np.frombuffer(row["disparity"], np.float32).reshape(expected.shape), expected)
    assert start(*arguments).communicate()[0].splitlines()[0] == "2 pairs, 0 to do"
