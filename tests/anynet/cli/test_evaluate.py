from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from anynet import AnyNet, save_checkpoint
from anynet.cli import main
from anynet.evaluation import opencv
from anynet.io import write_image

SMALL = "render:1?height=64&width=128"


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


def test_cameras(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A pair whose rows are off, with a calibration."""
    left, right, truth = stereo_motorcycle()
    write_image(tmp_path / "left.png", left)
    write_image(tmp_path / "right.png", np.roll(right, 3, axis=0))
    np.save(tmp_path / "truth.npy", truth)
    (tmp_path / "pairs.csv").write_text("left,right,disparity\nleft.png,right.png,truth.npy\n")
    (tmp_path / "K.txt").write_text("994.978 0 311.193 0 994.978 254.877 0 0 1\n0.193001\n")

    def d1(*options: str) -> tuple[float, str]:
        out = tmp_path / "out"
        data = f"csv:{tmp_path / 'pairs.csv'}"
        assert main(["evaluate", "--method", "bm", "--data", data, "--out", str(out), *options]) == 0
        errors = capsys.readouterr().err
        return json.loads((out / "results.json").read_text())[0]["stages"][0]["mean_over_images"]["d1"], errors

    off, errors = d1()
    assert "left: the pair looks unrectified" in errors
    good, errors = d1("--fix-rows", "--calib", str(tmp_path / "K.txt"))
    assert "left: the right image was 2.9" in errors
    assert "unrectified" not in errors
    assert good < off - 20
    assert "Calibration: camera matrix and baseline." in (tmp_path / "out" / "results.md").read_text()
    data = ["--method", "bm", "--data", f"csv:{tmp_path / 'pairs.csv'}"]
    lines = [f"P{camera}: 700 0 370 {-70 * camera} 0 700 250 0 0 0 1 0\n" for camera in range(4)]
    (tmp_path / "calib.txt").write_text("".join(lines))
    for folder, cameras in (("image_0", "gray pair"), ("image_2", "color pair")):  # which the images' folder says
        (tmp_path / folder).mkdir()
        write_image(tmp_path / folder / "left.png", left)
        (tmp_path / "kitti.csv").write_text(f"left,right,disparity\n{folder}/left.png,right.png,truth.npy\n")
        known = ["--method", "bm", "--data", f"csv:{tmp_path / 'kitti.csv'}", "--calib", str(tmp_path / "calib.txt")]
        assert main(["evaluate", *known]) == 0
        assert cameras in capsys.readouterr().out
    assert main(["evaluate", *data, "--raw"]) == 2
    assert "expected a calibration of raw cameras to rectify with (--raw), got none" in capsys.readouterr().err


def test_every_split_wants_data(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--splits", "--method", "bm", "--data", "render:1", "--data", "render:1"]) == 2
    assert "as many weights as data; got 1, 1, 2" in capsys.readouterr().err
    twice = ["--weights", "paper", "--data", "render:1"] * 2
    assert main(["evaluate", "--splits", *twice]) == 2
    assert "expected splits that differ" in capsys.readouterr().err
    mixed = ["--weights", "paper", "--method", "bm", "--data", SMALL, "--data", SMALL]
    assert main(["evaluate", "--splits", *mixed]) == 2
    streams = capsys.readouterr()
    assert streams.err == "anynet: --splits: expected methods of as many stages, got 4, 1\n"


@pytest.mark.parametrize("options", [[], ["--splits"]])
def test_methods_run_once_before_they_are_measured(monkeypatch: pytest.MonkeyPatch, options: list[str]) -> None:
    runs: list[tuple[int, ...]] = []
    bm = opencv.bm
    monkeypatch.setattr(opencv, "bm", lambda left, right: runs.append(left.shape) or bm(left, right))
    assert main(["evaluate", "--method", "bm", "--data", SMALL, *options]) == 0
    assert runs == [(64, 128, 3)] * 2


def test_no_image_to_read_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("0.png", "right.png"):
        write_image(tmp_path / name, np.zeros((48, 64, 3), np.uint8))
    np.save(tmp_path / "truth.npy", np.ones((48, 64), np.float32))
    (tmp_path / "pairs.csv").write_text("left,right,disparity\n0.png,right.png,truth.npy\n")
    data = f"csv:{tmp_path / 'pairs.csv'}"
    assert main(["evaluate", "--method", "bm", "--data", data, "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith(f"anynet: {tmp_path / '0.png'}: is one of the files to read; ")


@pytest.mark.parametrize("options", [[], ["--confidence"]])
def test_an_output_folder_that_cannot_be_made_is_told_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, options: list[str]
) -> None:
    def worked(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("anynet.evaluation.evaluate.compare", worked)
    monkeypatch.setattr("anynet.evaluation.confidence.evaluate_confidence", worked)
    (tmp_path / "file").touch()
    assert main(["evaluate", "--data", "render:1", "--out", str(tmp_path / "file"), *options]) == 2
    assert capsys.readouterr().err == f"anynet: cannot make the folder {tmp_path / 'file'}: File exists\n"


@pytest.mark.parametrize("options", [[], ["--confidence"], ["--perturb", "dark"]])
def test_a_table_that_cannot_be_written_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    (tmp_path / ("confidence.md" if "--confidence" in options else "results.md")).mkdir()
    assert main(["evaluate", "--data", SMALL, "--out", str(tmp_path), *options]) == 2
    streams = capsys.readouterr()
    assert f"| default | {SMALL} | all |" in streams.out
    assert streams.err.startswith("anynet: cannot write ")


@pytest.mark.parametrize("options", [[], ["--confidence"], ["--perturb", "dark"]])
def test_what_was_measured_before_an_error_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    (tmp_path / "pairs.csv").write_text("left,right\nnone.png,none.png\n")
    assert main(["evaluate", "--data", SMALL, "--data", f"csv:{tmp_path / 'pairs.csv'}", *options]) == 2
    streams = capsys.readouterr()
    assert f"| default | {SMALL} | all |" in streams.out
    assert f"anynet: cannot read {tmp_path / 'none.png'}" in streams.err


@pytest.mark.parametrize("options", [[], ["--confidence"]])
def test_pairs_without_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]) -> None:
    """Left out, also of the figures; out of range, they are null in the JSON."""
    for name in ("a", "b", "c"):
        write_image(tmp_path / f"{name}.png", np.zeros((64, 96, 3), np.uint8))
    np.save(tmp_path / "b.npy", np.full((64, 96), 9, np.float32))
    np.save(tmp_path / "c.npy", np.full((64, 96), 300, np.float32))
    table, out = tmp_path / "pairs.csv", tmp_path / "out"
    arguments = ["evaluate", "--data", f"csv:{table}", "--no-check", "--out", str(out), *options]

    table.write_text("left,right\na.png,a.png\n")
    assert main(arguments) == 2
    streams = capsys.readouterr()
    assert (streams.out, streams.err) == (
        "", "anynet: expected pairs with known disparities to evaluate on, got none: a\n",
    )  # fmt: skip

    table.write_text("left,right,disparity\na.png,a.png,\nb.png,b.png,b.npy\nc.png,c.png,c.npy\n")
    assert main(arguments) == 0
    assert "anynet: warning: a: no known disparity, left out\n" in capsys.readouterr().err
    if not options:
        text = (out / "results.json").read_text()
        images = json.loads(text)[0]["stages"][0]["images"]
        assert "NaN" not in text
        assert list(images) == ["b", "c"]
        assert images["c"]["epe"] is None
        assert (out / "0.png").exists()

    table.write_text("left,right,disparity\nc.png,c.png,c.npy\n")
    if options:
        assert main(arguments) == 2
        assert "no pixel of region 'all' has a disparity that counts" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--method", "bm", "--input-scale", "2"], "--input-scale, --device and --precision belong to networks"),
        (["--method", "bm", "--device", "auto"], "--input-scale, --device and --precision belong to networks"),
        (["--model", "psmnet", "--precision", "float16"], "--precision belongs to --weights"),
        (["--model", "nvtiny", "--input-scale", "0"], "BaselineConfig: expected input_scale from 0.0625 to 4, got 0.0"),
    ],
)
def test_wrong_options(capsys: pytest.CaptureFixture[str], options: list[str], message: str) -> None:
    assert main(["evaluate", "--data", "render:1", *options]) == 2
    assert capsys.readouterr().err.startswith(f"anynet: {message}")
