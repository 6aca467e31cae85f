"""Scoring of methods: regions, holes, stages; the authors' weights on KITTI."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from anynet import Predictor
from anynet.data import StereoSample, open_dataset
from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import Image, Method, compare, evaluate, fill_holes, region_mask
from anynet.predictor import Estimate

SHARED = Path(__file__).parents[4] / "shared"
NAN = np.nan


def _sample(disparity: npt.ArrayLike, **masks: npt.NDArray[np.bool_]) -> StereoSample:
    disparity = np.asarray(disparity, np.float32)
    image = np.zeros((*disparity.shape, 3), np.uint8)
    return StereoSample(image, image, disparity, np.isfinite(disparity), name="hand-made", **masks)


def test_pixels_that_count() -> None:
    sample = _sample([[NAN, 0, 1, 191, 192]], foreground=np.array([[1, 1, 1, 0, 0]], bool))
    assert region_mask(sample, "all").tolist() == [[False, False, True, True, False]]
    assert region_mask(sample, "foreground").tolist() == [[False, False, True, False, False]]
    assert region_mask(sample, "background").tolist() == [[False, False, False, True, False]]
    with pytest.raises(AnyNetError, match="hand-made: the data do not tell 'noc'"):
        region_mask(sample, "noc")


def test_holes_take_the_farther_neighbor() -> None:
    disparity = np.array([[NAN, 5, NAN, NAN, 3], [NAN, NAN, NAN, NAN, NAN], [7, NAN, 9, 9, NAN]], np.float32)
    assert fill_holes(disparity).tolist() == [[5, 5, 3, 3, 3], [5, 5, 3, 3, 3], [7, 7, 9, 9, 9]]
    assert np.isnan(fill_holes(np.full((2, 2), NAN, np.float32))).all()


def test_every_stage_is_scored_over_all_pairs() -> None:
    samples = [_sample([[10, 20, 30, 40]]), _sample([[10, 20, NAN, NAN]])]

    def method(left: Image, right: Image) -> Iterator[Estimate]:
        yield Estimate(1, np.array([[20, 20, 30, 40]], np.float32), 1.0)
        yield Estimate(2, np.array([[10, NAN, 30, 40]], np.float32), 2.0)

    evaluation = evaluate(method, samples)
    first, second = evaluation.stages
    assert (first.stage, first.milliseconds, first.density) == (1, 1.0, 100)
    assert (first.mean.d1, first.pooled.d1) == (37.5, pytest.approx(100 / 3))
    assert (second.stage, second.milliseconds, second.density) == (2, 2.0, pytest.approx(200 / 3))
    assert [image.epe for image in second.images] == [2.5, 5.0]  # 20 was filled with 10
    with pytest.raises(AnyNetError, match="no pairs"):
        evaluate(method, [])


def test_methods_take_turns_and_run_once_for_all_regions() -> None:
    foreground = np.array([[True, False]])
    samples = [_sample([[10, 20]], foreground=foreground), _sample([[30, 40]], foreground=foreground)]
    turns: list[str] = []

    def method(name: str) -> Method:
        def run(left: Image, right: Image) -> Iterator[Estimate]:
            turns.append(name)
            yield Estimate(1, np.array([[10, 20]], np.float32), 1.0)

        return run

    results = compare({"a": method("a"), "b": method("b")}, samples, ["foreground", "background"])
    assert turns == ["a", "b", "a", "b"]
    assert list(results) == [(name, region) for name in "ab" for region in ("foreground", "background")]
    for (_, region), evaluation in results.items():
        assert [image.epe for image in evaluation.stages[0].images] == [0, 20], region
        assert [image.pixels for image in evaluation.stages[0].images] == [1, 1]


def _authors_crop(sample: StereoSample) -> StereoSample:
    """The bottom right 1232x368 pixels, black where the image is smaller."""

    def crop(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        array = array[-368:, -1232:]
        before = [(368 - array.shape[0], 0), (1232 - array.shape[1], 0), (0, 0)]
        return np.pad(array, before[: array.ndim])

    return StereoSample(
        *(crop(a) for a in (sample.left, sample.right, sample.disparity, sample.valid)), name=sample.name
    )


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason=f"the KITTI pairs and the authors' weights are not in {SHARED}")
def test_the_authors_weights_on_kitti() -> None:
    samples = [_authors_crop(sample) for sample in open_dataset(f"kitti2015:{SHARED / 'data' / 'kitti2015'}")]
    evaluation = evaluate(Predictor(SHARED / "checkpoints" / "kitti2015.tar").stages, samples)
    assert len(evaluation.names) == 35
    assert [stage.mean.d1 for stage in evaluation.stages] == pytest.approx([14.66, 9.97, 6.69, 6.03], abs=0.05)
