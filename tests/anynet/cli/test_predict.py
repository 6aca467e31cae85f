from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from plyfile import PlyData

from anynet import Predictor
from anynet.io import read_disparity, read_image, write_image

from .conftest import Run

SHARED = Path(__file__).parents[3] / ".." / "shared"
MIDDLEBURY = "cam0=[100 0 30; 0 100 20; 0 0 1]\ndoffs=30\nbaseline=200\n"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_one_pair(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    out = tmp_path / "a" / "b"
    result = run("predict", *pair, "--out", out, "--weights", weights)
    assert (result.status, result.err) == (0, "")
    assert names(out) == ["left_colour.png", "left_disparity.png"]
    assert result.out.startswith("left: 64 x 48, stage 4 after ")
    times = [float(t) for t in result.out.split("after ")[1].split(" ms")[0].split(", ")]
    assert len(times) == 4
    assert times == sorted(times)
    assert str(out / "left_disparity.png") in result.out
    expected = Predictor(weights).predict(*(read_image(path) for path in pair)).disparity
    np.testing.assert_allclose(read_disparity(out / "left_disparity.png"), expected.clip(1 / 256), atol=1 / 256)
    assert read_image(out / "left_colour.png").shape[0] == 48


@pytest.mark.parametrize("kind", ["pfm", "npy"])
def test_formats(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path, kind: str) -> None:
    assert run("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--format", kind).status == 0
    disparity = read_disparity(tmp_path / "out" / f"left_disparity.{kind}")
    expected = Predictor(weights).predict(*(read_image(path) for path in pair)).disparity
    np.testing.assert_allclose(disparity, expected, atol=1e-4)


def test_stage_and_all_stages(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--format", "npy", "--json")
    result = run(*arguments, "--stage", 2, "--all-stages")
    report = json.loads(result.out)
    assert report["stage"] == 2
    assert len(report["elapsed_ms"]) == 2
    assert sorted(Path(file).name for file in report["files"].values()) == names(tmp_path / "out")
    assert names(tmp_path / "out") == [
        "left_colour.png",
        "left_disparity.npy",
        "left_stage1_colour.png",
        "left_stage1_disparity.npy",
    ]
    predictor = Predictor(weights)
    for file, stage in (("left_stage1_disparity.npy", 1), ("left_disparity.npy", 2)):
        expected = predictor.predict(*(read_image(path) for path in pair), stage=stage).disparity
        np.testing.assert_allclose(np.load(tmp_path / "out" / file), expected, atol=1e-4)


def test_budget(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--json", "--budget-ms")
    assert json.loads(run(*arguments, 0).out)["stage"] == 1
    assert json.loads(run(*arguments, 100_000).out)["stage"] == 4


def test_depth_and_cloud(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    calib, out = tmp_path / "calib.txt", tmp_path / "out"
    calib.write_text(MIDDLEBURY)
    arguments = ("predict", *pair, "--out", out, "--weights", weights, "--format", "npy")
    assert run(*arguments, "--calib", calib).status == 0
    disparity = np.load(out / "left_disparity.npy")
    depth = cv2.imread(str(out / "left_depth.tiff"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.float32
    behind = disparity <= -30
    assert 0 < behind.mean() < 0.5
    np.testing.assert_allclose(depth, np.where(behind, np.nan, 100 * 0.2 / (disparity + 30)), rtol=1e-5)
    vertices = PlyData.read(out / "left_cloud.ply")["vertex"].data
    np.testing.assert_array_equal(vertices["z"], depth[~behind])
    np.testing.assert_array_equal(vertices["red"], read_image(pair[0])[~behind, 0])

    nearer = float(np.nanmedian(depth))
    assert run(*arguments, "--calib", calib, "--max-depth", nearer).status == 0
    assert PlyData.read(out / "left_cloud.ply")["vertex"].data["z"].max() <= nearer


def test_calibration_in_numbers_and_replaced(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    calib = tmp_path / "calib.txt"
    calib.write_text(MIDDLEBURY)
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--json")
    given = json.loads(run(*arguments, "--focal", 500, "--baseline", 0.1, "--doffs", 3).out)["calibration"]
    assert given == {"focal": 500, "baseline": 0.1, "cx": None, "cy": None, "doffs": 3, "size": None}
    given = json.loads(run(*arguments, "--calib", calib, "--baseline", 0.1).out)["calibration"]
    assert given == {"focal": 100, "baseline": 0.1, "cx": 30, "cy": 20, "doffs": 30, "size": None}


@pytest.mark.parametrize("how", ["folders", "patterns"])
def test_many_pairs(run: Run, folders: tuple[Path, Path], weights: Path, tmp_path: Path, how: str) -> None:
    given = [folder if how == "folders" else folder / "*.png" for folder in folders]
    result = run("predict", *given, "--out", tmp_path / "out", "--weights", weights, "--json")
    assert (result.status, result.err) == (0, "")
    assert [json.loads(line)["name"] for line in result.out.splitlines()] == ["a", "b", "c"]
    assert len(names(tmp_path / "out")) == 6


def test_a_batch_goes_on_after_a_bad_pair(run: Run, folders: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    bad = folders[1] / "b.png"
    bad.write_bytes(bad.read_bytes()[:500])
    shutil.copy(folders[0] / "a.png", folders[0] / "d.png")  # has no partner
    result = run("predict", *folders, "--out", tmp_path / "out", "--weights", weights)
    assert result.status == 2
    assert result.err.splitlines() == [
        f"anynet: {folders[0] / 'd.png'}: no image of this name in the other folder",
        f"anynet: b: cannot read {bad}: damaged image (image file is truncated)",
        "anynet: 1 of 3 pairs failed, 1 images have no partner",
    ]
    assert [line.split(":")[0] for line in result.out.splitlines()] == ["a", "c"]
    assert [name[0] for name in names(tmp_path / "out")] == list("aacc")
    result = run("predict", *folders, "--out", tmp_path / "out", "--weights", weights, "--json")
    reports = [json.loads(line) for line in result.out.splitlines()]
    assert [("error" in report) for report in reports] == [False, True, False]


def test_swapped_images_are_told(run: Run, weights: Path, tmp_path: Path) -> None:
    from skimage.data import stereo_motorcycle

    for name, image in zip(("left", "right"), stereo_motorcycle()[:2], strict=True):
        write_image(tmp_path / f"{name}.png", image)
    swapped = (
        "predict",
        tmp_path / "right.png",
        tmp_path / "left.png",
        "--out",
        tmp_path / "out",
        "--weights",
        weights,
    )
    result = run(*swapped)
    assert result.status == 0
    assert result.err.startswith("anynet: right: warning: left and right look swapped: ")
    assert result.err.count("\n") == 1
    assert run(*swapped, "--no-check").err == ""


@pytest.mark.skipif(not SHARED.exists(), reason="the authors' weights and the real pairs are not in ../shared")
def test_real_pair_in_metres(run: Run, tmp_path: Path) -> None:
    data = SHARED / "data" / "kitti_object"
    weights = SHARED / "checkpoints" / "kitti2015.tar"
    pair = [data / side / "000001.png" for side in ("left", "right")]
    calib = data / "calib" / "000001.txt"
    assert run("predict", *pair, "--out", tmp_path, "--weights", weights, "--calib", calib).status == 0
    depth = cv2.imread(str(tmp_path / "000001_depth.tiff"), cv2.IMREAD_UNCHANGED)
    truth = read_disparity(data / "gt_depth_map" / "000001.png")  # the same format, in metres
    assert np.nanmedian(np.abs(depth - truth) / truth) < 0.1


def test_a_pair_does_not_wait_for_what_it_does_not_need(pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    code = (
        "import sys; from anynet.cli import main; status = main(sys.argv[1:]); "
        "print({'sympy', 'matplotlib', 'skimage', 'scipy', 'rich.progress'} & set(sys.modules)); sys.exit(status)"
    )
    command = [sys.executable, "-c", code, "predict", *pair, "--out", tmp_path, "--weights", weights]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "set()"
