from __future__ import annotations

from pathlib import Path

import pytest
from trees import check, tree

from anynet.data import open_dataset
from anynet.errors import AnyNetError


def test_scene_flow_layouts(tmp_path: Path) -> None:
    for name in (
        "TRAIN/A/0000/{}/0006", "TEST/B/0001/{}/0007", "a_rain_of_stones/{}/0000",
        "35mm_focallength/scene_forwards/fast/{}/0001",
    ):  # fmt: skip
        for side in ("left", "right"):
            tree(tmp_path, *(f"frames_{p}pass/{name.format(side)}.png" for p in ("clean", "final")))
            tree(tmp_path, f"disparity/{name.format(side)}.pfm")
    root = f"scene_flow:{tmp_path}"
    check(open_dataset(root + "?within=TRAIN"), ["TRAIN/A/0000/0006"])
    check(open_dataset(root + "?within=35mm&appearance=final"), ["35mm_focallength/scene_forwards/fast/0001"])
    assert len(open_dataset(root)) == 4
    assert open_dataset(root)[0].noc is not None
    with pytest.raises(AnyNetError, match="within TRAIN/C; found disparity/, frames_cleanpass/, frames_finalpass/"):
        open_dataset(root + "?within=TRAIN/C")


def test_files_that_macos_puts_beside_others(tmp_path: Path) -> None:
    for folder, ending in (("frames_cleanpass/a/left", "png"), ("frames_cleanpass/a/right", "png"),
                           ("disparity/a/left", "pfm")):  # fmt: skip
        tree(tmp_path, f"{folder}/0.{ending}")
        (tmp_path / folder / f"._0.{ending}").write_bytes(b"\0\5\26\7")
    check(open_dataset(f"scene_flow:{tmp_path}"), ["a/0"])
