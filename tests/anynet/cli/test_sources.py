from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from anynet.cli.sources import open_source, size_of
from anynet.errors import AnyNetError
from anynet.io import write_image
from anynet.streams import ImageFiles


def test_images_by_folders_patterns_and_split(folders: tuple[Path, Path], tmp_path: Path) -> None:
    for left, right in (folders, [folder / "*.png" for folder in folders]):
        with open_source(str(left), str(right), rate=5) as source:
            assert isinstance(source, ImageFiles)
            assert source.rate == 5
            assert [frame.name for frame in source.frames()] == ["a", "b", "c"]
    both = tmp_path / "both"
    both.mkdir()
    for name in "de":
        write_image(both / f"{name}.png", np.zeros((8, 24, 3), np.uint8))
    for given in (both, both / "*.png"):
        frames = list(open_source(str(given), split=True).frames())
        assert [frame.name for frame in frames] == ["d", "e"]
        assert frames[0].left.shape == (8, 12, 3)


def test_images_without_a_partner_are_told(folders: tuple[Path, Path]) -> None:
    (folders[0] / "c.png").rename(folders[0] / "d.png")
    source = open_source(*map(str, folders))
    assert [frame.name for frame in source.frames()] == ["a", "b"]
    assert sorted(source.warnings) == [f"{folders[0] / 'd.png'}: no partner", f"{folders[1] / 'c.png'}: no partner"]


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        (["a.mp4"], {}, "a.mp4: expected RIGHT too, or --split"),
        (["a.mp4", "b.mp4"], {"split": True}, "--split is for one source"),
        (["a.mcap", "b.mcap"], {}, "expected no RIGHT beside the recording a.mcap"),
        (["a.mp4", "b.mp4"], {"topics": ("/l", "/r")}, "--topics belongs to ROS bags and MCAP files, got a.mp4"),
        (["a.mp4", "b.mp4"], {"topic": "/l"}, "--topic belongs to ROS bags and MCAP files, got a.mp4"),
        (["0", "1"], {"slop": 0.0}, "--slop belongs to ROS bags and MCAP files, got 0"),
        (["a.mp4", "b.mp4"], {"size": "64x48"}, "--size belongs to live sources, got a.mp4"),
        (["*.png", "*.png"], {"reconnect": 0.0}, "--reconnect belongs to live sources, got *.png"),
        (["a.mcap"], {"size": "64x48"}, "--size belongs to live sources, got a.mcap"),
        (["a.mcap"], {"topics": ("/l", "/r"), "topic": "/l"}, "expected --topics, or --topic with --split, got both"),
        (["0", "b.mp4"], {}, "expected two live sources or two recorded ones, got 0 and b.mp4"),
        (["0", "1"], {"rate": 0.0}, "expected a rate above 0"),
        (["0", "1"], {"rate": float("nan")}, "expected a rate above 0"),
        (["77", "78"], {}, "cannot open 77: no such camera"),
        (["/dev/video77", "/dev/video78"], {}, "cannot open /dev/video77: no such camera"),
        (["none.mp4", "none.mp4"], {}, "cannot open none.mp4"),
        (["none.mcap"], {}, "none.mcap: not a readable ROS bag or MCAP file"),
        (["none.mcap"], {"slop": float("inf")}, "expected slop from 0 to 3600 seconds, got inf"),
        (["a.mcap"], {"split": True, "slop": 0.1}, "--slop is for recordings of two topics"),
        (["none/*.png", "none/*.png"], {}, "no file matches none/"),
    ],
)
def test_sources_that_cannot_be(names: list[str], options: dict[str, object], message: str) -> None:
    with pytest.raises(AnyNetError) as caught:
        open_source(*names, **options)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize("ending", [".mp4", ".bag", ".mcap", ".db3"])
def test_a_pipe_is_refused_not_waited_for(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"pipe{ending}"
    os.mkfifo(path)
    with pytest.raises(AnyNetError, match=f"cannot read {path}: expected a file, got a pipe"):
        open_source(str(path), split=True)


@pytest.mark.parametrize("index", ["9" * 30, "9" * 5000, "\u0663" * 12])
def test_an_index_that_no_camera_has(index: str) -> None:
    with pytest.raises(AnyNetError, match="expected the index of a camera, got "):
        open_source(index, split=True)


def test_size() -> None:
    assert size_of("1280x720") == (1280, 720)
    assert size_of(None) is None
    for text in ("1280", "1280x", "0x5", "axb", "1280x720x3", "9999999x1", f"{'9' * 5000}x1", "\u0663x1"):
        with pytest.raises(AnyNetError, match="expected a size like 1280x720, got "):
            size_of(text)
