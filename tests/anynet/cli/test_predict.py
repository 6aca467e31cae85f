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
from anynet.camera import StereoRig, read_calibration
from anynet.io import read_depth, read_disparity, read_image, write_image

from .conftest import Run

SHARED = Path(__file__).parents[3] / ".." / "shared"
MIDDLEBURY = "cam0=[100 0 30; 0 100 20; 0 0 1]\ndoffs=30\nbaseline=200\n"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_one_pair(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    out = tmp_path / "a" / "b"
    result = run("predict", *pair, "--out", out, "--weights", weights)
    assert (result.status, result.err) == (0, "")
    assert names(out) == ["left_color.png", "left_disparity.png"]
    assert result.out.startswith("left: 64 x 48, stage 4 after ")
    times = [float(t) for t in result.out.split("after ")[1].split(" ms")[0].split(", ")]
    assert len(times) == 4
    assert times == sorted(times)
    assert str(out / "left_disparity.png") in result.out
    expected = Predictor(weights).predict(*(read_image(path) for path in pair)).disparity
    known = np.where(expected > 0, expected.clip(1 / 256), np.nan)
    assert 0 < np.isnan(known).mean() < 0.5
    np.testing.assert_allclose(read_disparity(out / "left_disparity.png"), known, atol=1 / 256)
    assert read_image(out / "left_color.png").shape[0] == 48


@pytest.mark.parametrize("kind", ["pfm", "npy"])
def test_formats(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path, kind: str) -> None:
    assert run("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--format", kind).status == 0
    disparity = read_disparity(tmp_path / "out" / f"left_disparity.{kind}")
    expected = Predictor(weights).predict(*(read_image(path) for path in pair)).disparity
    np.testing.assert_allclose(disparity, np.where(expected > 0, expected, np.nan), atol=1e-4)


def test_stage_and_all_stages(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--format", "npy", "--json")
    result = run(*arguments, "--stage", 2, "--all-stages")
    report = json.loads(result.out)
    assert report["stage"] == 2
    assert len(report["elapsed_ms"]) == 2
    assert sorted(Path(file).name for file in report["files"].values()) == names(tmp_path / "out")
    assert names(tmp_path / "out") == [
        "left_color.png",
        "left_disparity.npy",
        "left_stage1_color.png",
        "left_stage1_disparity.npy",
    ]
    predictor = Predictor(weights)
    for file, stage in (("left_stage1_disparity.npy", 1), ("left_disparity.npy", 2)):
        expected = predictor.predict(*(read_image(path) for path in pair), stage=stage).disparity
        known = np.where(expected > 0, expected, np.nan)
        np.testing.assert_allclose(np.load(tmp_path / "out" / file), known, atol=1e-4)


def test_budget(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--json", "--budget-ms")
    assert json.loads(run(*arguments, 0).out)["stage"] == 1
    assert json.loads(run(*arguments, 100_000).out)["stage"] == 4


def test_a_time_says_of_which_stage_it_is(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--json")
    for options, stages in (([], [1, 2, 3, 4]), (["--stage", 2], [1, 2]), (["--budget-ms", 0], [1])):
        report = json.loads(run(*arguments, *options).out)
        assert report["stages"] == stages
        assert len(report["elapsed_ms"]) == len(stages)


def test_shards_have_every_pair_once(run: Run, folders: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    for shard, expected in (("1/2", "ac"), ("2/2", "b"), ("4/4", "")):
        out = tmp_path / shard.replace("/", "of")
        result = run("predict", *folders, "--out", out, "--weights", weights, "--shard", shard)
        assert (result.status, result.err) == (0, "")
        assert [name[0] for name in names(out) if name.endswith("disparity.png")] == list(expected)
    for shard in ("0/2", "3/2", "1", "a/b"):
        result = run("predict", *folders, "--out", tmp_path, "--weights", weights, "--shard", shard)
        assert (result.status, result.err) == (
            2, f"anynet: --shard: expected I/N with I from 1 to N, like 1/4, got {shard!r}\n"
        )  # fmt: skip


def test_depth_and_cloud(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    calib, out = tmp_path / "calib.txt", tmp_path / "out"
    calib.write_text(MIDDLEBURY)
    arguments = ("predict", *pair, "--out", out, "--weights", weights, "--format", "npy")
    assert run(*arguments, "--calib", calib).status == 0
    disparity = np.load(out / "left_disparity.npy")
    depth = cv2.imread(str(out / "left_depth.tiff"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.float32
    behind = np.isnan(disparity)
    assert 0 < behind.mean() < 0.5
    np.testing.assert_allclose(depth, 100 * 0.2 / (disparity + 30), rtol=1e-5)
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
    report = json.loads(run(*arguments, "--focal", 500, "--baseline", 193).out)
    assert report["warnings"] == ["a baseline of 193 m is long: --baseline is in meters"]
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
def test_real_pair_in_meters(run: Run, tmp_path: Path) -> None:
    data = SHARED / "data" / "kitti_object"
    weights = SHARED / "checkpoints" / "kitti2015.tar"
    pair = [data / side / "000001.png" for side in ("left", "right")]
    calib = data / "calib" / "000001.txt"
    assert run("predict", *pair, "--out", tmp_path, "--weights", weights, "--calib", calib).status == 0
    depth = cv2.imread(str(tmp_path / "000001_depth.tiff"), cv2.IMREAD_UNCHANGED)
    truth = read_disparity(data / "gt_depth_map" / "000001.png")  # the same format, in meters
    assert np.nanmedian(np.abs(depth - truth) / truth) < 0.1


def test_a_pair_does_not_wait_for_what_it_does_not_need(pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    unneeded = {"sympy", "matplotlib", "skimage", "scipy", "rich.progress", "yaml", "PIL.PdfParser"}
    code = (
        "import sys; from anynet.cli import main; status = main(sys.argv[1:]); "
        f"print({unneeded} & set(sys.modules)); sys.exit(status)"
    )
    command = [sys.executable, "-c", code, "predict", *pair, "--out", tmp_path, "--weights", weights]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_all_files_agree_on_what_is_unknown(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    calib = tmp_path / "calib.txt"
    calib.write_text(MIDDLEBURY)
    unknown = []
    for kind in ("png", "pfm", "npy"):
        out = tmp_path / kind
        depths = ("--depth-format", "png", "--depth-format", "tiff", "--depth-format", "npy")
        result = run("predict", *pair, "--out", out, "--weights", weights, "--calib", calib, "--format", kind, *depths)
        assert result.status == 0
        unknown.append(np.isnan(read_disparity(out / f"left_disparity.{kind}")))
        unknown += [np.isnan(read_depth(out / f"left_depth.{ending}")) for ending in ("png", "tiff", "npy")]
        assert np.count_nonzero(~unknown[0]) == len(PlyData.read(out / "left_cloud.ply")["vertex"].data)
    assert 0 < unknown[0].mean() < 0.5
    for other in unknown[1:]:
        np.testing.assert_array_equal(other, unknown[0])


def test_disparities_that_a_png_does_not_hold(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--json")
    report = json.loads(run(*arguments, "--min-disparity", -20).out)
    assert report["files"]["disparity"].endswith(".pfm")
    assert any("written as PFM" in warning for warning in report["warnings"])
    assert np.nanmin(read_disparity(report["files"]["disparity"])) < 0
    assert report["notes"] == ["disparities looked for from -20 pixels on"]


def test_files_of_an_earlier_run_stay_and_are_told(
    run: Run, folders: tuple[Path, Path], weights: Path, tmp_path: Path
) -> None:
    """And no file of the user's is removed."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "a_disparity.npy").touch()
    (out / "notes_disparity.png").touch()

    def told(*options: object) -> str:
        before = names(out)
        result = run("predict", *folders, "--out", out, "--weights", weights, *options)
        assert result.status == 0
        assert set(before) <= set(names(out))
        return result.err

    calib = ("--focal", 100, "--baseline", 0.1)
    line = f"anynet: a: warning: {out}: not of this run, but from before: "
    assert told("--all-stages", "--confidence", *calib) == line + "a_disparity.npy\n"
    assert told("--all-stages", "--confidence", *calib) == line + "a_disparity.npy\n"
    (out / "a_disparity.npy").unlink()
    assert told("--all-stages", "--confidence", *calib) == ""
    assert told("--all-stages", "--confidence", *calib, "--depth-format", "npy") == line + "a_depth.tiff\n"
    stages = "".join(f", a_stage{stage}_color.png, a_stage{stage}_disparity.png" for stage in (1, 2, 3))
    others = "a_cloud.ply, a_confidence.png, a_depth.npy, a_depth.tiff, a_disparity.png, a_occluded.png"
    assert told("--format", "pfm") == f"{line}{others}{stages}\n"


def test_an_image_to_read_is_not_told(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    left, right = shutil.copy(pair[0], tmp_path / "a.png"), shutil.copy(pair[1], tmp_path / "a_disparity.png")
    (tmp_path / "a_color.png").touch()
    result = run("predict", left, right, "--out", tmp_path, "--weights", weights, "--format", "pfm", "--no-check")
    assert (result.status, result.err) == (0, "")
    assert right.read_bytes() == pair[1].read_bytes()


@pytest.mark.parametrize("depth", ["nan", "-5", "0"])
def test_max_depth(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path, depth: str) -> None:
    result = run("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--max-depth", depth)
    assert (result.status, result.err) == (2, f"anynet: expected --max-depth > 0, got {depth}\n")


RAW = """%YAML:1.0
---
width: 64
height: 48
K1: [100., 0., 32., 0., 101., 24., 0., 0., 1.]
D1: [-0.1, 0.01, 0., 0.]
K2: [102., 0., 31., 0., 101., 25., 0., 0., 1.]
D2: [-0.1, 0.01, 0., 0.]
R: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
T: [-120., 0., 0.]
"""


def test_raw_images(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    calib = tmp_path / "rig.yml"
    calib.write_text(RAW)
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights, "--json", "--calib", calib)
    result = run(*arguments, "--calib-unit", "mm", "--save-rectified", "--format", "npy")
    report = json.loads(result.out)
    assert report["calibration"]["baseline"] == pytest.approx(0.12)
    assert report["calibration"]["size"] == [64, 48]
    assert "rectified by the calibration of raw cameras" in report["notes"]
    rig = read_calibration(calib, unit="mm")
    assert isinstance(rig, StereoRig)
    rectified = rig.rectify()(*(read_image(path) for path in pair))
    for side, image in zip(("left", "right"), rectified, strict=True):
        np.testing.assert_array_equal(read_image(report["files"][f"rectified_{side}"]), image)
    disparity = np.load(report["files"]["disparity"])
    assert np.isnan(disparity[~rig.rectify().valid]).all()
    told = run(*arguments).err
    assert told.count("a baseline of 120 m is long") == 1
    assert "--calib-unit mm" in told
    not_warped = json.loads(run(*arguments, "--calib-unit", "mm", "--rectified").out)
    assert not_warped["notes"] == ["calibration: OpenCV, K1 and K2, rectified"]
    result = run(*arguments, "--calib-unit", "mm", "--focal", 90)
    assert "of raw cameras: --focal cannot replace" in result.err
    wider = json.loads(run(*arguments, "--baseline", 0.3).out)
    assert wider["calibration"]["baseline"] == pytest.approx(0.3)


@pytest.mark.parametrize("command", ["predict", "demo"])
def test_a_warning_that_explains_an_error_comes_before_it(
    run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path, command: str
) -> None:
    calib = tmp_path / "rig.yml"
    rectified = "P1: [100., 0., 32., 0., 0., 100., 24., 0., 0., 0., 1., 0.]\n"
    calib.write_text(
        RAW.replace("-0.1, 0.01, 0., 0.", "1.")
        + rectified
        + rectified.replace("P1", "P2").replace("32., 0.", "32., -12.")
    )
    result = run(command, *pair, "--out", tmp_path / "out", "--weights", weights, "--calib", calib, "--raw")
    assert (result.status, result.out) == (2, "")
    warning, error = result.err.splitlines()
    assert warning.startswith(f"anynet: warning: {calib}: the raw cameras are left out: expected 4, 5, 8, 12, 14 ")
    assert error.startswith("anynet: expected a calibration of raw cameras to rectify with (--raw), got none")


def test_units_and_pairs_belong_to_files(run: Run, pair: tuple[Path, Path], weights: Path, tmp_path: Path) -> None:
    arguments = ("predict", *pair, "--out", tmp_path / "out", "--weights", weights)
    assert "--calib-unit and --calib-pair belong to --calib" in run(*arguments, "--calib-unit", "mm").err
    assert "--raw" in run(*arguments, "--raw").err
    calib = tmp_path / "calib.txt"
    calib.write_text(MIDDLEBURY)
    assert "expected a unit of m, dm, cm" in run(*arguments, "--calib", calib, "--calib-unit", "yd").err
    given = run(*arguments, "--calib", calib, "--calib-unit", "cm", "--json")
    assert json.loads(given.out)["calibration"]["baseline"] == 2
