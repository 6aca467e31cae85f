"""The paper's evaluation, on the smallest of data: every command, and that nothing is done twice."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import paper
import pytest
from PIL import Image

from anynet.baselines import MODELS
from anynet.data import StereoSample
from anynet.evaluation.anytime import Curve
from anynet.evaluation.splits import draw_splits, write_splits
from anynet.predictor import Estimate

DATA = "render:5?height=64&width=128"


def test_every_network_has_its_points():
    names = [point.name for point in paper.POINTS]
    assert len(set(names)) == len(names) == 4 + 3 * len(MODELS)
    assert {"anynet", "separate-features", "full-range", "concatenation", "psmnet-basic-16"} <= set(names)
    assert set(paper.ERRORS) <= set(MODELS)
    assert set(paper.TX2) <= set(MODELS)
    assert len({point.recipe.network for point in paper.ABLATIONS}) == 4
    for point in paper.SMALL_BASELINES:
        assert point.name == f"{point.recipe.model}-{round(1 / point.recipe.input_scale)}"


def test_splits_are_those_of_the_files(tmp_path):
    names = [f"{i:06d}_10" for i in range(35)]
    files = write_splits(names, tmp_path)
    for chosen, file in zip(draw_splits(35), files, strict=True):
        assert [names[i] for i in chosen] == file.read_text().split()


def test_runs_of_their_own_wait_for_one_another():
    options = {"names": ("a", "b"), "milliseconds": (10.0, 50.0), "errors": (20.0, 5.0), "deviations": (0.0, 0.0)}
    assert paper.Measured("m", **options, stages=True).curve() == Curve((10.0, 50.0), (20.0, 5.0))
    assert paper.Measured("m", **options, stages=False).curve() == Curve((10.0, 60.0), (20.0, 5.0))


def test_a_matcher_at_a_quarter_gives_pixels_of_the_whole():
    random = np.random.default_rng(0)
    coarse = random.integers(0, 256, (16, 120, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    left, right = np.ascontiguousarray(coarse[:, :880]), np.ascontiguousarray(coarse[:, 80:960])
    (estimate,) = paper.at_scale(paper.opencv.bm, 1 / 4)(left, right)
    assert estimate.disparity.shape == left.shape[:2]
    found = estimate.disparity[np.isfinite(estimate.disparity)]
    assert found.size > 1000
    assert np.median(found) == pytest.approx(80, abs=2)


@pytest.mark.slow
def test_every_command(tmp_path, monkeypatch):
    def run(command: str, *more: str) -> None:
        options = ["--data", DATA, "--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "out"), "--threads", "1"]
        options += ["--splits", "2", "--rounds", "1", *more]
        monkeypatch.setattr(sys, "argv", ["paper.py", command, *options])
        paper.main()

    small = ["--pretraining", "render:2?height=64&width=128", "--steps", "1", "--fine-tuning-steps", "1"]
    small += ["--batch-size", "1", "--crop-size", "64", "128", "--only", "anynet", "--only", "nvtiny-4"]
    with pytest.raises(SystemExit, match="run train first"):
        run("fig5")
    run("train", *small)
    weights = sorted((tmp_path / "runs").glob("*/*/weights.safetensors"))
    assert [path.parent.relative_to(tmp_path / "runs").as_posix() for path in weights] == [
        f"{name}/{run}" for name in ("anynet", "nvtiny-4") for run in ("pretraining", "render-split0", "render-split1")
    ]
    made = {path: path.stat().st_mtime_ns for path in weights}
    run("train", *small)
    assert made == {path: path.stat().st_mtime_ns for path in weights}
    results = {}
    other = tmp_path / "other.safetensors"
    shutil.copy(weights[0], other)
    for command in ("table2", "fig5", "fig6", "fig7"):
        run(command, "--weights", "default", "--weights", str(other))
        with Image.open(tmp_path / "out" / f"{command}.png") as image:
            assert min(image.size) > 100
        results[command] = json.loads((tmp_path / "out" / f"{command}.json").read_text())
        text = (tmp_path / "out" / f"{command}.md").read_text()
        assert text.startswith("|" if command == "table2" else "![")
    assert len(results["table2"][DATA]["milliseconds"]) == 4
    assert results["table2"][DATA]["errors"]["splits"] == 2
    assert [line["label"] for line in results["fig6"][DATA]["lines"]] == [
        "AnyNet",
        "nvtiny",
        "OpenCV BM",
        "OpenCV SGBM",
        "weights default",
        "weights other",
    ]
    assert "| best cascade: default to stage " in (tmp_path / "out" / "fig6.md").read_text()
    assert set(results["fig7"][DATA]["milliseconds"]) == {point.name for point in paper.ABLATIONS}
    assert list(results["fig7"][DATA]["errors"]) == ["anynet"]
    before = results["table2"]
    run("table2")
    assert json.loads((tmp_path / "out" / "table2.json").read_text()) == before  # remembered, times too
    monkeypatch.setattr(paper, "evaluate", None)
    with pytest.raises(TypeError):
        run("table2", "--again")


def _work(folder: Path, data: list[str], weights: Sequence[str] = ()) -> paper.Work:
    return paper.Work(
        threads=1, data=data, runs=folder, out=folder, only=None, pretraining="", steps=1, fine_tuning_steps=1,
        batch_size=1, crop_size=(64, 128), splits=3, device="cpu", rounds=1, weights=list(weights), full_size=False,
        again=False,
    )  # fmt: skip


def _evaluated(d1: float) -> SimpleNamespace:
    return SimpleNamespace(stages=[SimpleNamespace(mean=SimpleNamespace(d1=d1))])


def test_weights_of_runs_are_told_apart(tmp_path, monkeypatch):
    for run in ("one", "two", "more/two"):
        (tmp_path / run).mkdir(parents=True)
        (tmp_path / run / "weights.safetensors").write_bytes(run.encode())
    files = [str(tmp_path / run / "weights.safetensors") for run in ("one", "two", "more/two")]
    monkeypatch.chdir(tmp_path / "one")
    assert [paper.weights_name(name) for name in ("default", "a/b.safetensors", *files, "weights.safetensors")] == [
        "default", "b", "one", "two", "two", "one",
    ]  # fmt: skip
    with pytest.raises(SystemExit, match="expected files of different names"):
        _work(tmp_path, [DATA], files)
    work = _work(tmp_path, [DATA], files[:2])
    measured = {}
    for number, file in enumerate((files[1], files[2], files[1])):
        monkeypatch.setattr(paper, "evaluate", lambda *_, n=number: _evaluated(n))
        measured[number] = paper.errors_of(work, "weights two", DATA, paper.everywhere(work, None), [file]).mean
    assert measured == {0: (0,), 1: (1,), 2: (2,)}
    monkeypatch.setattr(paper, "evaluate", None)  # what is known is not measured again
    assert paper.errors_of(work, "weights two", DATA, paper.everywhere(work, None), [files[1]]).mean == (2,)


def test_data_of_one_kind_are_told_apart(tmp_path, monkeypatch):
    other = DATA.replace("render:5", "render:6")
    with pytest.raises(SystemExit, match="expected one data set of a kind"):
        _work(tmp_path, [DATA, other])
    for number, spec in enumerate((DATA, other)):
        work = _work(tmp_path, [spec])
        monkeypatch.setattr(paper, "evaluate", lambda *_, n=number: _evaluated(n))
        assert paper.errors_of(work, "m", spec, paper.everywhere(work, None)).mean == (number,)
        estimates = [Estimate(1, np.zeros((1, 1), np.float32), float(number))]
        times = paper.times_of(work, spec, "m", {"m": lambda *_, e=estimates: e}, work.datasets[spec][0])
        assert times == {"m": [number]}


def test_pairs_of_a_split_are_apart(tmp_path):
    work = _work(tmp_path, [DATA])
    for number in range(3):
        learned, measured = work.split(DATA, number)
        assert (len(learned), len(measured)) == (4, 1)
        assert isinstance(measured[0], StereoSample)
        assert not any(np.array_equal(measured[0].left, pair.left) for pair in learned)
    assert work.trained(paper.ANYNET, DATA) == []
    assert paper.training_table(work, paper.POINTS) == "No network has been trained.\n"
    assert Path(work.folder(paper.ANYNET, DATA, 2)).name == "render-split2"
