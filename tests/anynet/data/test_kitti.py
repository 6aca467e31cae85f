from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from trees import SIZE, check, tree

from anynet.data import open_dataset
from anynet.errors import AnyNetError


@pytest.mark.parametrize(
    ("kind", "left", "right", "suffix"),
    [
        ("kitti2015", "image_2", "image_3", "_0"),
        ("kitti2012", "colored_0", "colored_1", ""),
        ("kitti2012", "image_0", "image_1", ""),
    ],
)
def test_kitti_layouts(tmp_path: Path, kind: str, left: str, right: str, suffix: str) -> None:
    for frame in ("000000_10.png", "000003_10.png"):
        tree(tmp_path / "training", f"{left}/{frame}", f"{right}/{frame}", f"disp_noc{suffix}/{frame}")
    tree(tmp_path / "training", f"{left}/000003_11.png", f"disp_occ{suffix}/000003_10.png", f"{left}/000005_10.png")
    cv2.imwrite(str(tmp_path / "training" / f"disp_noc{suffix}" / "000003_10.png"), np.zeros(SIZE, np.uint16))
    (tmp_path / "training/obj_map").mkdir()
    cv2.imwrite(str(tmp_path / "training/obj_map/000003_10.png"), np.eye(*SIZE, dtype=np.uint8))
    check(open_dataset(f"{kind}:{tmp_path}")[:1], ["000000_10"])
    occ = open_dataset(f"{kind}:{tmp_path}?truth=occ")
    check(occ, ["000003_10"])
    assert not occ[0].noc.any()
    assert occ[0].foreground.sum() == min(SIZE)
    (tmp_path / "list.txt").write_text("000003\n000000_10.png\n")
    assert [s.name for s in open_dataset(f"{kind}:{tmp_path}?split=list.txt")] == ["000003_10", "000000_10"]
    (tmp_path / "list.txt").write_text("000003\n")
    assert [s.name for s in open_dataset(f"{kind}:{tmp_path}?without=list.txt")] == ["000000_10"]
    (tmp_path / "list.txt").write_text("000009\n3\n000003\n")
    for option in ("split", "without"):
        with pytest.raises(AnyNetError, match=r"names 000009_10 \(and 1 more\), not there with"):
            open_dataset(f"{kind}:{tmp_path}?{option}=list.txt")


@pytest.mark.parametrize("content", [b"", b"\xff\xfe1", b"\xe9\n"])
def test_damaged_split_files(tmp_path: Path, content: bytes) -> None:
    for camera in ("image_2", "image_3"):
        tree(tmp_path / "training", f"{camera}/000000_10.png")
    tree(tmp_path / "training", "disp_noc_0/000000_10.png")
    (tmp_path / "list.txt").write_bytes(content)
    if content:
        with pytest.raises(AnyNetError, match=r"list\.txt: not a text in UTF-8"):
            open_dataset(f"kitti2015:{tmp_path}?split=list.txt")
    else:
        assert len(open_dataset(f"kitti2015:{tmp_path}?split=list.txt")) == 0


def test_files_that_macos_puts_beside_others(tmp_path: Path) -> None:
    folders = [tmp_path / "training" / name for name in ("image_2", "image_3", "disp_noc_0")]
    tree(tmp_path / "training", *(f"{folder.name}/000000_10.png" for folder in folders))
    for folder in folders:
        (folder / "._000000_10.png").write_bytes(b"\0\5\26\7")
    check(open_dataset(f"kitti2015:{tmp_path}"), ["000000_10"])
