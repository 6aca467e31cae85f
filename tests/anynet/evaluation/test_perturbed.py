from __future__ import annotations

import numpy as np
import pytest

from anynet.data.perturb import PERTURBATIONS
from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import compare
from anynet.evaluation.opencv import sgbm
from anynet.evaluation.perturbed import CLEAN, Perturbed, chosen, markdown
from anynet.samples import StereoSample
from anynet.synthetic import render


@pytest.fixture(scope="module")
def sample() -> StereoSample:
    return render(5, 128, 256, preset="things")


def test_the_truth_stays_and_the_noise_repeats(sample: StereoSample) -> None:
    dark = Perturbed([sample], "dark")
    assert len(dark) == 1
    assert np.array_equal(dark[0].left, dark[0].left)
    assert dark[0].left.mean() < sample.left.mean() / 4
    assert np.array_equal(dark[0].disparity, sample.disparity)


def test_names() -> None:
    assert chosen(["all"]) == list(PERTURBATIONS)
    assert chosen(["jpeg", "rows1"]) == ["rows1", "jpeg"]
    with pytest.raises(AnyNetError, match=r"expected all or one of rows1, .*, got 'snow'"):
        chosen(["snow"])


def test_table(sample: StereoSample) -> None:
    tables = {
        name: {("SGBM", "things", "all"): compare({"SGBM": sgbm}, samples)["SGBM", "all"]}
        for name, samples in ((CLEAN, [sample]), ("rows2", Perturbed([sample], "rows2")))
    }
    clean, rows = (table["SGBM", "things", "all"].stages[-1].mean.d1 for table in tables.values())
    assert rows > clean > 0
    assert f"| SGBM | things | all | {clean:.2f} | {rows:.2f} ({rows / clean:.2f}x) |" in markdown(tables)
