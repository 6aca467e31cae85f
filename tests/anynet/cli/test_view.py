"""What `anynet view` and `anynet stream --view` hand to the page: the same sources, the same calibrations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from bags import START, BagWriter

from anynet.camera import PairPreparation
from anynet.streams import Source

from .conftest import Run

CALIB = ("--focal", 100, "--baseline", 0.1)


def folder(tmp_path: Path, folders: tuple[Path, Path]) -> tuple[object, ...]:
    return folders


def pattern(tmp_path: Path, folders: tuple[Path, Path]) -> tuple[object, ...]:
    return tuple(path / "*.png" for path in folders)


def one_pair(tmp_path: Path, folders: tuple[Path, Path]) -> tuple[object, ...]:
    return tuple(path / "a.png" for path in folders)


def video(tmp_path: Path, folders: tuple[Path, Path]) -> tuple[object, ...]:
    writer = cv2.VideoWriter(str(tmp_path / "both.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (128, 48))
    for level in range(3):
        writer.write(np.full((48, 128, 3), 50 * level, np.uint8))
    writer.release()
    return tmp_path / "both.avi", "--split"


def recording(tmp_path: Path, folders: tuple[Path, Path]) -> tuple[object, ...]:
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    with BagWriter(tmp_path / "in.bag") as bag:
        for index in range(3):
            for side in ("a", "b"):
                bag.image(f"/{side}/image", np.full((48, 64, 3), index, np.uint8), START + 1_000_001 * index)
    return tmp_path / "in.bag", "--topics", "/a/image", "/b/image", "--slop", 0.02


@pytest.mark.parametrize("command", [["view"], ["stream", "--view"]], ids=["view", "stream"])
@pytest.mark.parametrize("kind", [folder, pattern, one_pair, video, recording])
def test_sources(
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    folders: tuple[Path, Path],
    tmp_path: Path,
    command: list[str],
    kind: Callable[..., tuple[object, ...]],
) -> None:
    shown: list[object] = []

    def show(source: Source, prepare: PairPreparation, *arguments: object, **options: object) -> None:
        size, frames = source.size, list(source.frames())
        shown.extend([len(frames), size, prepare(frames[0].left, frames[0].right).calibration])
        shown.append(options.get("rate", arguments[-1]))

    monkeypatch.setattr("anynet.cli.stream.show", show)  # which imports the other, so it goes first
    monkeypatch.setattr("anynet.cli.view.show", show)
    result = run(*command, *kind(tmp_path, folders), *CALIB, "--rate", 5)
    assert (result.status, result.err) == (0, "")
    count, size, calibration, rate = shown
    assert (count, size, rate) == (1 if kind is one_pair else 3, (64, 48), 5)
    assert calibration is not None
    assert calibration.baseline == 0.1


@pytest.mark.parametrize("scale", ["-1", "0", "nan", "5"])
@pytest.mark.parametrize("command", [["view"], ["stream", "--view"]], ids=["view", "stream"])
def test_a_wrong_scale_is_told_before_the_page_is_up(
    run: Run, monkeypatch: pytest.MonkeyPatch, pair: tuple[Path, Path], command: list[str], scale: str
) -> None:
    view = pytest.importorskip("anynet.view.view", reason="the page needs viser (extra view)")
    monkeypatch.setattr(view, "Page", None)
    result = run(*command, *pair, "--input-scale", scale)
    assert (result.status, result.out) == (2, "")
    assert result.err == f"anynet: AnyNetConfig: expected input_scale from 0.0625 to 4, got {float(scale)}\n"
