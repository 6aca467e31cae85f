"""Scoring of methods: regions, holes, stages, tables, the command; the authors' weights on KITTI."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from anynet import AnyNet, Predictor, save_checkpoint
from anynet.cli import main
from anynet.data import StereoSample, open_dataset
from anynet.errors import AnyNetError
from anynet.evaluation import opencv, report
from anynet.evaluation.evaluate import Evaluation, Stage, compare, evaluate, filled, region_mask
from anynet.evaluation.metrics import Scores
from anynet.evaluation.splits import write_splits
from anynet.predictor import Estimate

SHARED = Path(__file__).parents[4] / "shared"
NAN = np.nan


def _sample(disparity, **masks) -> StereoSample:
    disparity = np.float32(disparity)
    image = np.zeros((*disparity.shape, 3), np.uint8)
    return StereoSample(image, image, disparity, np.isfinite(disparity), name="hand-made", **masks)


def test_pixels_that_count():
    sample = _sample([[NAN, 0, 1, 191, 192]], foreground=np.array([[1, 1, 1, 0, 0]], bool))
    assert region_mask(sample, "all").tolist() == [[False, False, True, True, False]]
    assert region_mask(sample, "foreground").tolist() == [[False, False, True, False, False]]
    assert region_mask(sample, "background").tolist() == [[False, False, False, True, False]]
    with pytest.raises(AnyNetError, match="hand-made: the data do not tell 'noc'"):
        region_mask(sample, "noc")


def test_holes_take_the_farther_neighbor():
    disparity = np.float32([[NAN, 5, NAN, NAN, 3], [NAN, NAN, NAN, NAN, NAN], [7, NAN, 9, 9, NAN]])
    assert filled(disparity).tolist() == [[5, 5, 3, 3, 3], [5, 5, 3, 3, 3], [7, 7, 9, 9, 9]]
    assert np.isnan(filled(np.full((2, 2), NAN, np.float32))).all()


def test_every_stage_is_scored_over_all_pairs():
    samples = [_sample([[10, 20, 30, 40]]), _sample([[10, 20, NAN, NAN]])]

    def method(left, right):
        yield Estimate(1, np.float32([[20, 20, 30, 40]]), 1.0)
        yield Estimate(2, np.float32([[10, NAN, 30, 40]]), 2.0)

    evaluation = evaluate(method, samples)
    first, second = evaluation.stages
    assert (first.stage, first.milliseconds, first.density) == (1, 1.0, 100)
    assert (first.mean.d1, first.pooled.d1) == (37.5, pytest.approx(100 / 3))
    assert (second.stage, second.milliseconds, second.density) == (2, 2.0, pytest.approx(200 / 3))
    assert [image.epe for image in second.images] == [2.5, 5.0]  # 20 was filled with 10
    with pytest.raises(AnyNetError, match="no pairs"):
        evaluate(method, [])


def test_methods_take_turns_and_run_once_for_all_regions():
    foreground = np.array([[True, False]])
    samples = [_sample([[10, 20]], foreground=foreground), _sample([[30, 40]], foreground=foreground)]
    turns = []

    def method(name):
        def run(left, right):
            turns.append(name)
            yield Estimate(1, np.float32([[10, 20]]), 1.0)

        return run

    results = compare({"a": method("a"), "b": method("b")}, samples, ["foreground", "background"])
    assert turns == ["a", "b", "a", "b"]
    assert list(results) == [(name, region) for name in "ab" for region in ("foreground", "background")]
    for (_, region), evaluation in results.items():
        assert [image.epe for image in evaluation.stages[0].images] == [0, 20], region
        assert [image.pixels for image in evaluation.stages[0].images] == [1, 1]


@pytest.mark.parametrize("method", [opencv.bm, opencv.sgbm])
def test_opencv_finds_a_shifted_texture(method):
    scene = np.random.default_rng(0).integers(0, 256, (60, 420, 3), np.uint8)
    truth = np.full((60, 400), 20, np.float32)
    sample = StereoSample(scene[:, :400], scene[:, 20:420], truth, np.ones_like(truth, bool))
    (stage,) = evaluate(method, [sample]).stages
    assert stage.density > 50
    assert stage.mean.bad1 < 15


def _evaluation(*d1s: float) -> Evaluation:
    stages = (Stage(i, (Scores(1, 2, 3, 4, d1, 100),), 10.0 * i, 100.0) for i, d1 in enumerate(d1s, 1))
    return Evaluation(("a",), tuple(stages))


def test_the_table_of_splits():
    table = report.splits_markdown([_evaluation(*d1s) for d1s in [(10, 5), (12, 5), (14, 5), (16, 5), (18, 5)]])
    assert "| 1 | 14.00 ± 3.16 | 10.0 |" in table
    assert "| 2 | 5.00 ± 0.00 | 20.0 |" in table
    assert "of 5 splits" in table


def test_splits_share_the_names(tmp_path):
    names = [f"{i:06d}_10" for i in range(35)]
    splits = [path.read_text().split() for path in write_splits(names, tmp_path)]
    assert len({tuple(split) for split in splits}) == 5
    assert all(len(split) == 7 and set(split) < set(names) for split in splits)


def test_the_command_writes_tables_and_figures(tmp_path, capsys):
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


def test_the_command_wants_data_for_every_split(capsys):
    assert main(["evaluate", "--splits", "--method", "bm", "--data", "render:1", "--data", "render:1"]) == 2
    assert "as many weights as data; got 1, 1, 2" in capsys.readouterr().err


def _authors_crop(sample: StereoSample) -> StereoSample:
    """The bottom right 1232x368 pixels, black where the image is smaller."""

    def crop(array):
        array = array[-368:, -1232:]
        before = [(368 - array.shape[0], 0), (1232 - array.shape[1], 0), (0, 0)]
        return np.pad(array, before[: array.ndim])

    return StereoSample(
        *(crop(a) for a in (sample.left, sample.right, sample.disparity, sample.valid)), name=sample.name
    )


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason=f"the KITTI pairs and the authors' weights are not in {SHARED}")
def test_the_authors_weights_on_kitti():
    samples = [_authors_crop(sample) for sample in open_dataset(f"kitti2015:{SHARED / 'data' / 'kitti2015'}")]
    evaluation = evaluate(Predictor(SHARED / "checkpoints" / "kitti2015.tar").stages, samples)
    assert len(evaluation.names) == 35
    assert [stage.mean.d1 for stage in evaluation.stages] == pytest.approx([14.66, 9.97, 6.69, 6.03], abs=0.05)
