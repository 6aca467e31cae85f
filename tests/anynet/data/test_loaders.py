"""The loaders, on real pairs where they are present and on tiny trees of the same layout."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from anynet.data import Dataset, StereoSample, open_dataset
from anynet.errors import AnyNetError
from anynet.io import write_disparity, write_image

SHARED = Path(__file__).resolve().parents[4] / "shared" / "data"
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
SIZE = (12, 20)
Tree = Callable[..., None]


def mismatch(sample: StereoSample, offset: int) -> float:
    """Mean difference of left pixels and the right ones `offset` away from where the truth says they are."""
    left, right = (cv2.GaussianBlur(image, (0, 0), 1).astype(np.float32) for image in (sample.left, sample.right))
    y, x = np.nonzero(sample.valid if sample.noc is None else sample.noc)
    match = np.rint(x - sample.disparity[y, x]).astype(int) + offset
    inside = (match >= 0) & (match < left.shape[1])
    return float(np.abs(left[y, x] - right[y, np.clip(match, 0, left.shape[1] - 1)])[inside].mean())


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


def tree(root: Path, *entries: str) -> None:
    """Files with these paths: gray images of level 90, disparities of 3 pixels (PNG: 16 bits, 8 if named 8:PATH)."""
    for entry in entries:
        path = root / entry.removeprefix("8:")
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".pfm":
            write_disparity(path, np.full(SIZE, 3, np.float32))
        elif entry.startswith("8:"):
            cv2.imwrite(str(path), np.full(SIZE, 24, np.uint8))
        elif "disp" in entry:
            write_disparity(path, np.full(SIZE, 3, np.float32))
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), np.full((*SIZE, 3), 90, np.uint8))


def check(dataset: Dataset, names: list[str], disparity: float = 3) -> None:
    assert [s.name for s in dataset] == names
    for sample in dataset:
        assert sample.left.shape == (*SIZE, 3)
        assert np.allclose(sample.disparity, disparity)
        assert sample.valid.all()


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
    (tmp_path / "list.txt").write_text("000009\n")
    with pytest.raises(AnyNetError, match="names 000009_10"):
        open_dataset(f"{kind}:{tmp_path}?split=list.txt")


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


def test_own_folders_and_table(tmp_path: Path) -> None:
    tree(tmp_path, "left/a.png", "right/a.png", "disparity/a.pfm", "left/b.png")
    check(open_dataset(f"folders:{tmp_path}"), ["a"])
    (tmp_path / "calib.txt").write_text("cam0=[100 0 10; 0 100 6; 0 0 1]\nbaseline=120\ndoffs=1\nwidth=20\nheight=12\n")
    np.save(tmp_path / "depth.npy", np.full(SIZE, 3, np.float32))
    listing = tmp_path / "pairs.csv"
    listing.write_text(
        "left,right,disparity,depth,calibration\n"
        "left/a.png,right/a.png,disparity/a.pfm,,\n"
        "left/a.png,right/a.png,,depth.npy,calib.txt\n"
        "left/a.png,right/a.png,,,\n"
    )
    measured, computed, unknown = open_dataset(f"csv:{listing}")
    assert np.allclose(measured.disparity, 3)
    assert np.allclose(computed.disparity, 100 * 0.12 / 3 - 1)
    assert not unknown.valid.any()
    assert np.isnan(unknown.disparity).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("left,disparity\n", "expected columns among left, right"),
        ("left,right,color\n", "expected columns among left, right"),
        (
            "left,right,depth\na.png,b.png,c.npy\n",
            r"pairs.csv:2: expected left, right, and disparity or depth \+ calibration",
        ),
    ],
)
def test_wrong_tables(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "pairs.csv").write_text(text)
    with pytest.raises(AnyNetError, match=message):
        open_dataset(f"csv:{tmp_path / 'pairs.csv'}")


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


def test_truth_of_another_size_than_the_images(tmp_path: Path) -> None:
    tree(tmp_path, "left/a.png", "right/a.png")
    (tmp_path / "disparity").mkdir()
    write_disparity(tmp_path / "disparity/a.pfm", np.ones((5, 6), np.float32))
    with pytest.raises(AnyNetError, match=r"a.pfm: expected 20 x 12 pixels like the images, got \(6, 5\)"):
        open_dataset(f"folders:{tmp_path}")[0]


@pytest.mark.parametrize("spec", ["render:abc", "render:-1", "render:1?height=x", "render:1?height=3", "render:1?a=2"])
def test_options_that_cannot_be(spec: str) -> None:
    with pytest.raises(AnyNetError, match=r"^[^\n]+$"):
        open_dataset(spec)


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


def test_an_image_whose_size_cannot_be_read(tmp_path: Path) -> None:
    for name in ("im2.png", "im6.png", "disp2.png"):
        (tmp_path / name).write_bytes(b"damaged")
    with pytest.raises(AnyNetError, match=r"cannot read .*im2\.png: not an image"):
        open_dataset(f"middlebury2003:{tmp_path}")
