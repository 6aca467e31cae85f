from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from anynet.errors import AnyNetError
from anynet.io import write_image
from anynet.streams import ImageFiles


def pair(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 256, (2, 8, 12, 3), dtype=np.uint8)


def test_pairs_at_a_rate(tmp_path: Path) -> None:
    files = []
    for index in range(3):
        paths = tmp_path / f"l{index}.png", tmp_path / f"r{index}.png"
        for path, image in zip(paths, pair(index), strict=True):
            write_image(path, image)
        files.append((f"pair{index}", *paths))
    with ImageFiles(files, rate=4) as source:
        frames = list(source.frames())
    assert [frame.name for frame in frames] == ["pair0", "pair1", "pair2"]
    assert [frame.time for frame in frames] == [0, 0.25, 0.5]
    assert [frame.stamp - frames[0].stamp for frame in frames] == [0, 250_000_000, 500_000_000]
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal([frame.left, frame.right], pair(index))
    assert ImageFiles(files).rate == 10


def test_side_by_side(tmp_path: Path) -> None:
    write_image(tmp_path / "both.png", np.hstack(list(pair(0))))
    (frame,) = ImageFiles([("both", tmp_path / "both.png", None)]).frames()
    np.testing.assert_array_equal([frame.left, frame.right], pair(0))
    write_image(tmp_path / "both.png", np.zeros((8, 13, 3), np.uint8))
    with pytest.raises(AnyNetError, match="expected side-by-side images of even width, got 13"):
        next(ImageFiles([("both", tmp_path / "both.png", None)]).frames())


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("split", [False, True])
def test_bits_that_are_used(tmp_path: Path, split: bool) -> None:
    """12 of 16; of a darker image after a bright one too."""
    files: list[tuple[str, Path, Path | None]] = []
    for index, level in enumerate((4095, 1000)):
        path = tmp_path / f"{index}.png"
        Image.fromarray(np.full((8, 12), level, np.uint16)).save(path)
        files.append((str(index), path, None if split else path))
    source = ImageFiles(files)
    assert source.size == (6 if split else 12, 8)
    for frame, level in zip(source.frames(), (255, 62), strict=True):
        assert (np.stack([frame.left, frame.right]) == level).all()


def test_sizes_that_differ(tmp_path: Path) -> None:
    paths = tmp_path / "a.png", tmp_path / "b.png"
    for path, width in zip(paths, (12, 10), strict=True):
        write_image(path, np.zeros((8, width, 3), np.uint8))
    with pytest.raises(AnyNetError, match=r"b\.png: expected two images of one size, got 12 x 8 and 10 x 8$"):
        next(ImageFiles([("a", *paths)]).frames())


def test_a_damaged_file_and_closing(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", pair(0)[0])
    (tmp_path / "b.png").write_bytes(b"\x89PNG garbage")
    files = [("a", tmp_path / "a.png", tmp_path / "a.png"), ("b", tmp_path / "b.png", tmp_path / "a.png")]
    source = ImageFiles(files)
    frames = source.frames()
    assert next(frames).name == "a"
    with pytest.raises(AnyNetError, match=r"cannot read .*b\.png"):
        next(frames)
    frames = source.frames()
    next(frames)
    source.close()
    assert list(frames) == []


def test_no_files_and_no_rate(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match=r"^expected pairs of image files, got none$"):
        ImageFiles([])
    for rate in (0, float("nan"), "10"):
        with pytest.raises(AnyNetError, match=r"^expected a rate > 0, got "):
            ImageFiles([("a", tmp_path / "a.png", None)], rate=rate)
