"""Data sets by name; the loaders of all layouts on real pairs, where they are present."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from trees import SHARED, mismatch

from anynet.data import open_dataset, open_datasets
from anynet.data.rendered import Rendered, write_rendered
from anynet.errors import AnyNetError

REAL = {
    "kitti2015:kitti2015": 35,
    "kitti2015:kitti2015?split=val.txt": 7,
    "kitti2015:kitti2015?without=val.txt": 28,
    "kitti2015:kitti2015?truth=occ": 3,
    "middlebury2006:middlebury2006": 12,
    "middlebury2003:middlebury2003": 1,
    "middlebury2014:middlebury2014Q": 1,
    "eth3d:eth3d": 1,
    "scene_flow:sceneflow": 3,
}


@pytest.mark.parametrize(("spec", "count"), REAL.items())
def test_truth_of_real_pairs_warps_right_onto_left(spec: str, count: int) -> None:
    kind, _, rest = spec.partition(":")
    if not (SHARED / rest.partition("?")[0]).exists():
        pytest.skip(f"no real pairs in {SHARED}")
    dataset = open_dataset(f"{kind}:{SHARED / rest}")
    assert len(dataset) == count
    for sample in dataset:
        assert sample.left.dtype == sample.right.dtype == np.uint8
        assert np.isfinite(sample.disparity[sample.valid]).all()
        assert np.isnan(sample.disparity[~sample.valid]).all()
        right_place, beside = mismatch(sample, 0), min(mismatch(sample, -3), mismatch(sample, 3))
        assert right_place < 0.9 * beside, sample.name


@pytest.mark.parametrize(
    "kind",
    [
        "kitti2012",
        "kitti2015",
        "middlebury2001",
        "middlebury2003",
        "middlebury2006",
        "middlebury2014",
        "eth3d",
        "scene_flow",
        "folders",
    ],
)
def test_wrong_roots_say_what_was_looked_for_and_found(tmp_path: Path, kind: str) -> None:
    (tmp_path / "photographs").mkdir()
    with pytest.raises(AnyNetError, match=r"expected .*(png|names|ppm).*; found photographs/"):
        open_dataset(f"{kind}:{tmp_path}")
    with pytest.raises(AnyNetError, match="there is no such folder"):
        open_dataset(f"{kind}:{tmp_path}/nowhere")


def test_specs(tmp_path: Path, rendering_here: None) -> None:
    list(write_rendered(tmp_path, 2, height=96, width=128))
    both = open_datasets([f"rendered:{tmp_path}", "render:1?seed=9&height=96&width=128"])
    assert len(both) == 3
    assert np.array_equal(both[2].left, Rendered(1, 9, 96, 128)[0].left)
    assert len(both[1:]) == 2


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("somewhere", "expected KIND:ROOT"),
        ("moon:somewhere", "expected KIND:ROOT"),
        ("rendered:somewhere?color=red", "expected no options, got 'color'"),
        ("folders:somewhere?scale=4&scale=9", "expected each option once, got 'scale=4&scale=9'"),
        ("folders:somewhere?scales=4", "expected options among scale, got 'scales'"),
        ("render:3?hight=96", "expected options among seed, height, width, got 'hight'"),
        ("render:abc", "expected the seed as a whole number, got 'abc'"),
        ("render:3?height=x", "expected height as a whole number, got 'x'"),
        ("rendered:/nowhere", "expected files NNNNNNN.npy written by `anynet render`, found none"),
    ],
)
def test_wrong_specs(spec: str, message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        open_datasets([spec])


@pytest.mark.parametrize("spec", ["render:abc", "render:-1", "render:1?height=x", "render:1?height=3", "render:1?a=2",
                                  "render:" + "9" * 20, "render:" + "9" * 5000, "render:1?height=16385",
                                  f"render:1?seed={2**63}"])  # fmt: skip
def test_options_that_cannot_be(spec: str) -> None:
    with pytest.raises(AnyNetError, match=r"^[^\n]+$"):
        open_dataset(spec)


@pytest.mark.parametrize("kind", [*sorted({spec.partition(":")[0] for spec in REAL}), "folders", "csv", "rendered"])
def test_names_that_are_too_long_are_told(tmp_path: Path, kind: str) -> None:
    with pytest.raises(AnyNetError, match=r"there is no such|found none"):
        open_dataset(f"{kind}:{tmp_path}/{'x' * 300}")


def test_split_files_of_names_that_are_too_long(tmp_path: Path) -> None:
    for place in ("image_2", "image_3", "disp_noc_0"):
        (tmp_path / "training" / place).mkdir(parents=True)
        (tmp_path / "training" / place / "000000_10.png").touch()
    with pytest.raises(AnyNetError, match="x: no such split file, neither in"):
        open_dataset(f"kitti2015:{tmp_path}?split={'x' * 300}")
