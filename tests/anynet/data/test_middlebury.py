from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from trees import SIZE, check, tree

from anynet.data import open_dataset
from anynet.errors import AnyNetError
from anynet.io import write_image


def test_middlebury_and_eth3d_layouts(tmp_path: Path) -> None:
    old = tmp_path / "2001"
    for side in (2, 6):
        tree(old / "venus", f"im{side}.ppm", f"8:disp{side}.pgm")
    for side in (0, 1):
        tree(old / "map", f"im{side}.ppm", f"8:disp{side}.pgm")
    check(open_dataset(f"middlebury2001:{old}"), ["map", "venus"])
    new = tmp_path / "2014"
    tree(new / "Adirondack", "im0.png", "im1.png", "disp0.pfm", "disp1.pfm")
    check(open_dataset(f"middlebury2014:{new}"), ["Adirondack"])
    assert open_dataset(f"middlebury2014:{new}")[0].noc[:, 3:].all()
    field = tmp_path / "eth3d"
    tree(field, "two_view_training/forest/im0.png", "two_view_training/forest/im1.png")
    tree(field, "two_view_training_gt/forest/disp0GT.pfm")
    cv2.imwrite(str(field / "two_view_training_gt/forest/mask0nocc.png"), np.full(SIZE, 128, np.uint8))
    check(open_dataset(f"eth3d:{field}"), ["forest"])
    assert not open_dataset(f"eth3d:{field}")[0].noc.any()


@pytest.mark.parametrize(
    ("place", "root"),
    [("two_view_training", "."), ("two_view_training/forest", "."), ("two_view_training/forest", "..")],
)
def test_eth3d_from_inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, root: str) -> None:
    tree(tmp_path, "two_view_training/forest/im0.png", "two_view_training/forest/im1.png")
    tree(tmp_path, "two_view_training_gt/forest/disp0GT.pfm")
    monkeypatch.chdir(tmp_path / place)
    check(open_dataset(f"eth3d:{root}"), ["forest"])


@pytest.mark.parametrize(
    ("kind", "files"),
    [
        ("middlebury2001", ["im2.ppm", "im6.ppm", "8:disp2.pgm"]),
        ("middlebury2003", ["im2.png", "im6.png", "disp2.png"]),
        ("middlebury2006", ["view1.png", "view5.png", "disp1.png"]),
    ],
)
def test_a_scene_opens_from_inside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, files: list[str]
) -> None:
    tree(tmp_path / "scene", *files)
    (tmp_path / "scene" / "inner").mkdir()
    (tmp_path / "inner").symlink_to(tmp_path / "scene" / "inner")
    monkeypatch.chdir(tmp_path / "scene" / "inner")
    for root in ("..", tmp_path / "inner" / ".."):
        assert [sample.name for sample in open_dataset(f"{kind}:{root}").files] == ["scene"]
    monkeypatch.chdir(tmp_path / "scene")
    assert [sample.name for sample in open_dataset(f"{kind}:.").files] == ["scene"]


def test_scale_of_middlebury_2006_follows_the_size(tmp_path: Path) -> None:
    for height, level in ((370, 30), (555, 20), (1110, 10)):
        scene = tmp_path / f"scene{height}"
        scene.mkdir()
        for view in (1, 5):
            write_image(scene / f"view{view}.png", np.zeros((height, 40, 3), np.uint8))
            cv2.imwrite(str(scene / f"disp{view}.png"), np.full((height, 40), level, np.uint8))
    for sample in open_dataset(f"middlebury2006:{tmp_path}"):
        assert np.allclose(sample.disparity, 10)
        assert sample.noc[:, 10:].all()
        assert not sample.noc[:, :10].any()


def test_an_image_whose_size_cannot_be_read(tmp_path: Path) -> None:
    for name in ("im2.png", "im6.png", "disp2.png"):
        (tmp_path / name).write_bytes(b"damaged")
    with pytest.raises(AnyNetError, match=r"cannot read .*im2\.png: not an image"):
        open_dataset(f"middlebury2003:{tmp_path}")
