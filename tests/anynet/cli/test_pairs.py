from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from anynet.cli.pairs import Pair, find_pairs
from anynet.errors import AnyNetError


def touch(root: Path, *names: str) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()


def test_two_files(tmp_path: Path) -> None:
    touch(tmp_path, "l.png", "r.png")
    expected = Pair("l", tmp_path / "l.png", tmp_path / "r.png")
    assert find_pairs(str(tmp_path / "l.png"), str(tmp_path / "r.png")) == ([expected], [])


def test_a_file_name_may_look_like_a_pattern(tmp_path: Path) -> None:
    touch(tmp_path, "l[1].png", "r[1].png")
    ((pair,), _) = find_pairs(str(tmp_path / "l[1].png"), str(tmp_path / "r[1].png"))
    assert pair.right == tmp_path / "r[1].png"


def test_folders_by_name(tmp_path: Path) -> None:
    touch(tmp_path, "l/b.png", "l/a.JPG", "l/notes.txt", "l/only_left.png", "r/a.JPG", "r/b.png", "r/only_right.png")
    pairs, alone = find_pairs(str(tmp_path / "l"), str(tmp_path / "r"))
    assert [(p.name, p.left.name, p.right.parent.name) for p in pairs] == [("a", "a.JPG", "r"), ("b", "b.png", "r")]
    assert [path.name for path in alone] == ["only_left.png", "only_right.png"]


def test_patterns_in_sorted_order(tmp_path: Path) -> None:
    touch(tmp_path, "2_left.png", "1_left.png", "1_right.png", "2_right.png")
    pairs, _ = find_pairs(str(tmp_path / "*_left.png"), str(tmp_path / "*_right.png"))
    assert [(p.name, p.right.name) for p in pairs] == [("1_left", "1_right.png"), ("2_left", "2_right.png")]


def test_results_of_equal_file_names_have_different_names(tmp_path: Path) -> None:
    touch(tmp_path, "x/one/im0.png", "x/one/im1.png", "x/two/im0.png", "x/two/im1.png")
    pairs, _ = find_pairs(str(tmp_path / "x/*/im0.png"), str(tmp_path / "x/*/im1.png"))
    assert [p.name for p in pairs] == ["one_im0", "two_im0"]


def test_equal_names_but_for_the_ending(tmp_path: Path) -> None:
    touch(tmp_path, "l/a.png", "l/a.jpg", "r/a.png", "r/a.jpg")
    pairs, _ = find_pairs(str(tmp_path / "l"), str(tmp_path / "r"))
    assert [p.name for p in pairs] == ["a_jpg", "a_png"]


def test_what_does_not_pair(tmp_path: Path) -> None:
    touch(tmp_path, "l/a.png", "l/b.png", "r/c.png", "empty/notes.txt")
    cases = [
        ("l", "r", "expected images of the same names in .* got 2 and 1 images without a common name"),
        ("l", "empty", "got 2 and 0 images"),
        ("l", "r/c.png", "expected two folders or two files"),
        ("l/*.png", "r/*.png", "expected as many left as right images, got 2 for .*, 1 for"),
        ("l/*.bmp", "r/*.png", r"no file matches .*bmp"),
    ]
    for left, right, message in cases:
        with pytest.raises(AnyNetError, match=message):
            find_pairs(str(tmp_path / left), str(tmp_path / right))


def results(name: str) -> set[str]:
    """The files that a pair's results go to, as a file system without case sees them."""
    stages = ["", "stage1_", "stage2_", "stage3_"]
    return {f"{name}_{stage}{kind}".casefold() for stage in stages for kind in ("disparity.png", "color.png")}


@pytest.mark.parametrize(
    "files",
    [
        ["a/b.png", "a_b.png", "b.png", "a_b_png.png"],
        ["a/b.png", "a_b.jpg", "a_b.png", "a.b.png", "b.png", "b.jpg", "a_b_png/x.png"],
        ["frame.png", "Frame.png", "FRAME.png"],
        ["x/a.png", "y/A.png", "x_A.png", "X/a.PNG"],
        ["stra\u00dfe.png", "strasse.png", "STRASSE.png"],
        ["caf\u00e9.png", "cafe\u0301.png"],
        ["a.png", "a_stage1.png", "a_stage1_stage2.png"],
        ["a_stage1.png", "b/a.png", "b/a_stage1.png"],
        ["a.png", "a.jpg", "a_png.png", "a_png_2.png", "a_jpg.png"],
    ],
)
def test_no_results_overwrite_others(tmp_path: Path, files: list[str]) -> None:
    touch(tmp_path, *files)
    pairs, alone = find_pairs(str(tmp_path / "**/*.*"), str(tmp_path / "**/*.*"))
    assert len(pairs) == len(files)
    assert alone == []
    written = [file for pair in pairs for file in results(pair.name)]
    assert len(set(written)) == len(written)


def test_links_are_named_by_themselves(tmp_path: Path) -> None:
    touch(tmp_path, "store/51aa", "store/52bb")
    for scene in "AB":
        (tmp_path / scene).mkdir()
        for number, name in enumerate(("51aa", "52bb")):
            (tmp_path / scene / f"im{number}.png").symlink_to(tmp_path / "store" / name)
    pairs, _ = find_pairs(str(tmp_path / "?/im0.png"), str(tmp_path / "?/im1.png"))
    assert [pair.name for pair in pairs] == ["A_im0", "B_im0"]


def test_link_loops_and_a_missing_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "loop.png").symlink_to("loop.png")
    (pair,), _ = find_pairs(str(tmp_path / "loop.png"), "loop.png")
    assert pair.name == "loop"
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert find_pairs("a/l.png", "r.png")[0][0].name == "l"


def test_hidden_files_are_no_images(tmp_path: Path) -> None:
    touch(tmp_path, "l/a.png", "l/._a.png", "r/a.png", "r/._a.png", "l/.DS_Store.png")
    pairs, alone = find_pairs(str(tmp_path / "l"), str(tmp_path / "r"))
    assert [pair.name for pair in pairs] == ["a"]
    assert alone == []


@pytest.mark.parametrize(
    ("left", "right", "numbers"),
    [
        ("left/{}.png", "right/{}.png", ["0001", "0003", "0004", "0005"]),
        ("left/l_{}.png", "right/r_{}.png", ["0001", "0003", "0004", "0005"]),
        ("cam0/img{}_a.png", "cam1/img{}_b.png", ["1", "3", "10", "11"]),
    ],
)
def test_a_lost_frame_does_not_shift_the_others(tmp_path: Path, left: str, right: str, numbers: list[str]) -> None:
    touch(tmp_path, *(left.format(number) for number in numbers))
    other = [numbers[0], "0002", *numbers[1:2], numbers[3]]
    touch(tmp_path, *(right.format(number) for number in other))
    wild = [str(tmp_path / name.split("/")[0] / "*.png") for name in (left, right)]
    pairs, alone = find_pairs(*wild)
    expected = [(left.format(number), right.format(number)) for number in (numbers[0], numbers[1], numbers[3])]
    found = [tuple(str(path.relative_to(tmp_path)) for path in (pair.left, pair.right)) for pair in pairs]
    assert sorted(found) == sorted(expected)
    assert [path.relative_to(tmp_path).as_posix() for path in alone] == [left.format(numbers[2]), right.format("0002")]


def test_a_number_of_the_camera_is_not_one_of_the_frame(tmp_path: Path) -> None:
    touch(tmp_path, *(f"{scene}/im{side}.png" for scene in "AB" for side in (0, 1)))
    pairs, alone = find_pairs(str(tmp_path / "*/im0.png"), str(tmp_path / "*/im1.png"))
    assert [(p.left.parent.name, p.right.parent.name) for p in pairs] == [("A", "A"), ("B", "B")]
    assert alone == []
    touch(tmp_path, "one/10.png", "one/20.png", "two/11.png", "two/21.png")  # times of two clocks
    pairs, alone = find_pairs(str(tmp_path / "one/*"), str(tmp_path / "two/*"))
    assert [(p.left.name, p.right.name) for p in pairs] == [("10.png", "11.png"), ("20.png", "21.png")]
    assert alone == []


@pytest.fixture(scope="module")
def ten_thousand_pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pairs")
    (folder / "0").touch()
    for side in ("l", "r"):
        (folder / side).mkdir()
        for number in range(10_000):
            os.link(folder / "0", folder / side / f"{number:05}.png")
    return folder


@pytest.mark.parametrize("how", ["folders", "patterns"])
def test_ten_thousand_pairs(ten_thousand_pairs: Path, how: str) -> None:
    given = [str(ten_thousand_pairs / side / ("" if how == "folders" else "*.png")) for side in ("l", "r")]
    for _ in range(3):  # of which the fastest counts: other work on the machine slows one down
        start = time.process_time()
        pairs, alone = find_pairs(*given)
        seconds = time.process_time() - start
        assert (len(pairs), len(alone)) == (10_000, 0)
        if seconds < 1:
            break
    assert seconds < 1
