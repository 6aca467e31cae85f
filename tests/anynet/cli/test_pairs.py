from __future__ import annotations

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
