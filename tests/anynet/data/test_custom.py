from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from trees import SIZE, check, tree

from anynet.data import open_dataset
from anynet.data.custom import table
from anynet.errors import AnyNetError
from anynet.io import write_depth, write_disparity, write_image

IMAGE = np.zeros((6, 8, 3), np.uint8)
CALIBRATION = "cam0=[100 0 4; 0 100 3; 0 0 1]\nbaseline=120\ndoffs=1\nwidth={}\nheight=6\n"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for side in ("left", "right", "disparity"):
        (tmp_path / side).mkdir()
    for side in ("left", "right"):
        write_image(tmp_path / side / "a.png", IMAGE)
    write_disparity(tmp_path / "disparity" / "a.pfm", np.ones((6, 8), np.float32))
    return tmp_path


def test_what_else_lies_in_folders_is_left_out(root: Path) -> None:
    for side in ("left", "right", "disparity"):
        (root / side / "a.txt").write_text("exposure 8 ms")
        (root / side / "._a.png").write_bytes(b"\0\5\26\7")
        (root / side / "._a.pfm").write_bytes(b"\0\5\26\7")
        (root / side / "z.json").write_text("{}")
    (sample,) = open_dataset(f"folders:{root}")
    assert sample.name == "a"
    assert sample.valid.all()


@pytest.mark.parametrize("scale", ["abc", "0", "-1", "nan", "inf", ""])
def test_impossible_scales(root: Path, scale: str) -> None:
    (root / "list.csv").write_text("left,right\nleft/a.png,right/a.png\n")
    for spec in (f"folders:{root}", f"csv:{root}/list.csv"):
        with pytest.raises(AnyNetError, match="expected scale > 0"):
            open_dataset(f"{spec}?scale={scale}")


def test_a_byte_order_mark_is_none_of_the_columns(root: Path) -> None:
    (root / "list.csv").write_text("\ufeffleft,right,disparity\r\nleft/a.png,right/a.png,disparity/a.pfm\r\n")
    (sample,) = open_dataset(f"csv:{root}/list.csv")
    assert sample.valid.all()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"left,right\na.png,b.png,c,d\n", "list.csv:2: expected left, right, and disparity"),
        (b"left,right\na.png\n", "list.csv:2: expected left, right, and disparity"),
        (b"left,right\n\xe9.png,b.png\n", "not a text in UTF-8"),
        (b'left,right\n"' + b"x" * 200_000 + b'",b\n', "not a CSV file"),
        (b"", "expected columns among left, right, .*, got 'none'"),
        (b"\n" * 1000, "expected columns among"),
        (b"left,right,left\nright\n" + b"\0", "list.csv"),
    ],
)
def test_damaged_tables(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "list.csv").write_bytes(content)
    with pytest.raises(AnyNetError, match=message) as caught:
        open_dataset(f"csv:{tmp_path}/list.csv")
    assert "list.csv" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_table_of_too_many_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anynet.data.custom.MAX_ROWS", 3)
    (tmp_path / "list.csv").write_text("left,right\n" + 4 * "a,b\n")
    with pytest.raises(AnyNetError, match=r"list\.csv: expected at most 3 rows"):
        open_dataset(f"csv:{tmp_path}/list.csv")


def test_our_own_depth_is_a_truth(root: Path) -> None:
    depth = np.full((6, 8), 3, np.float32)
    depth[0] = np.nan, 0, -1, *depth[0, 3:]
    write_depth(root / "depth.tiff", depth)
    (root / "calib.txt").write_text(CALIBRATION.format(8))
    (root / "list.csv").write_text("left,right,depth,calibration\nleft/a.png,right/a.png,depth.tiff,calib.txt\n")
    with pytest.warns(UserWarning, match=r"depth\.tiff: 1 of 47 known values are negative"):
        (sample,) = open_dataset(f"csv:{root}/list.csv")
    assert np.allclose(sample.disparity[1:], 100 * 0.12 / 3 - 1)
    assert sample.valid[0].tolist() == [False, False, False, True, True, True, True, True]


def test_a_unit_belongs_to_depth(root: Path) -> None:
    (root / "list.csv").write_text("left,right,disparity\nleft/a.png,right/a.png,disparity/a.pfm\n")
    with pytest.raises(AnyNetError, match=r"expected a unit of m, dm, .*, got 'parsec'"):
        open_dataset(f"csv:{root}/list.csv?unit=parsec")
    with pytest.raises(AnyNetError, match=r"list\.csv: expected a column depth, to which unit belongs, got none"):
        open_dataset(f"csv:{root}/list.csv?unit=mm")


def test_a_calibration_without_a_baseline(root: Path) -> None:
    write_depth(root / "depth.tiff", np.full((6, 8), 3, np.float32))
    (root / "calib.txt").write_text(CALIBRATION.format(8).replace("baseline=120\n", ""))
    (root / "list.csv").write_text("left,right,depth,calibration\nleft/a.png,right/a.png,depth.tiff,calib.txt\n")
    with pytest.raises(AnyNetError, match=r"lacks baseline: give --baseline, or add it to the file$"):
        open_dataset(f"csv:{root}/list.csv")[0]


def test_a_calibration_in_another_unit(root: Path) -> None:
    write_depth(root / "depth.tiff", np.full((6, 8), 3, np.float32))
    (root / "calib.txt").write_text(CALIBRATION.format(8))
    (root / "list.csv").write_text("left,right,depth,calibration\nleft/a.png,right/a.png,depth.tiff,calib.txt\n")
    with pytest.warns(
        UserWarning, match=r"a baseline of 120 m is long: .* Say it with --calib-unit mm .*, of a data set with unit=mm"
    ):
        open_dataset(f"csv:{root}/list.csv?unit=m")[0]


def test_a_calibration_of_another_size(root: Path) -> None:
    write_depth(root / "depth.tiff", np.full((6, 8), 3, np.float32))
    (root / "calib.txt").write_text(CALIBRATION.format(16))
    (root / "list.csv").write_text("left,right,depth,calibration\nleft/a.png,right/a.png,depth.tiff,calib.txt\n")
    with pytest.raises(AnyNetError, match="expected images of 16 x 6 as the calibration says, got 8 x 6"):
        open_dataset(f"csv:{root}/list.csv")[0]


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


def test_a_folder_is_no_table(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"expected a CSV file, got a folder: .* is folders:"):
        open_dataset(f"csv:{tmp_path}")


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


@pytest.mark.parametrize(("side", "ending"), [("left", ".jpg"), ("right", ".tiff"), ("disparity", ".npy")])
def test_two_files_of_one_name(root: Path, side: str, ending: str) -> None:
    kept = "a.pfm" if side == "disparity" else "a.png"
    (root / side / f"a{ending}").write_bytes(b"another")
    names = " and ".join(sorted([kept, f"a{ending}"]))
    with pytest.raises(AnyNetError, match=f"{root / side}: expected one file of a name, got {names}"):
        open_dataset(f"folders:{root}")


def test_rows_of_equal_file_names_have_different_names(tmp_path: Path) -> None:
    elsewhere = tmp_path / "b" / "im0.png"
    (tmp_path / "list.csv").write_text(f"left,right\na/im0.png,a/im1.png\n{elsewhere},b/im1.png\n")
    assert [row.name for row in table(os.path.relpath(tmp_path / "list.csv")).files] == ["a_im0", "b_im0"]
    (tmp_path / "list.csv").write_text("left,right\na/0.png,b/0.png\na/0.png,c/0.png\n")
    assert len({row.name for row in table(tmp_path / "list.csv").files}) == 2
    (tmp_path / "list.csv").write_text("left,right\n")
    assert table(tmp_path / "list.csv").files == []
