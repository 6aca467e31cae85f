"""From what the user named, a camera, video, folder, pattern or recording, to a source of frames."""

from __future__ import annotations

import glob
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from anynet.cli.pairs import find_pairs
from anynet.errors import AnyNetError
from anynet.io.images import endings

if TYPE_CHECKING:
    from anynet.streams import Source

Split = Annotated[bool, typer.Option("--split", help="SOURCE has both images side by side, left first.")]
Rate = Annotated[
    float | None,
    typer.Option(help="Frames per second: of images (10), of a recording in place of its own, asked of a camera."),
]
Size = Annotated[str | None, typer.Option(help="Image size that is asked of a camera, such as 1280x720.")]
Topics = Annotated[
    tuple[str, str] | None, typer.Option(help="Topics of a recording: left and right.", show_default="found by names")
]
Topic = Annotated[str | None, typer.Option(help="Topic of a recording with --split.", show_default="found")]
# None where not given: an option that a source does not have is refused.
Slop = Annotated[
    float | None,
    typer.Option(
        min=0, max=3600, help="Seconds that left and right images of a recording may be apart.", show_default="0.01"
    ),
]
Reconnect = Annotated[
    float | None,
    typer.Option(min=0, help="Seconds to go on trying to open a live source that stopped.", show_default="10"),
]

_BAGS = {".bag", ".mcap", ".db3"}
_FORMAT = "expected a size like 1280x720"


def open_source(
    source: str,
    right: str | None = None,
    *,
    split: bool = False,
    rate: float | None = None,
    size: str | None = None,
    topics: tuple[str, str] | None = None,
    topic: str | None = None,
    slop: float | None = None,
    reconnect: float | None = None,
) -> Source:
    """Opens what `anynet stream` takes.

    Args:
        source: index of a camera, device file, address of a network stream, video, folder or quoted pattern of images,
            ROS bag or MCAP file.
        right: the same for the right images, unless `source` has both.
        split: `source` has both images side by side.
        rate: frames per second; see `Stream`, `Capture`, `ImageFiles`.
        size: WIDTHxHEIGHT that cameras are asked for.
        topics: of a recording, left and right; see `Recording`, as for `slop` (0.01).
        topic: of a recording that is `split`, in their place.
        reconnect: of a live source; see `Capture` (10).

    Raises:
        AnyNetError: if it cannot be opened, or an option belongs to other sources.
    """
    from anynet.streams import Capture, ImageFiles, Recording

    asked = size_of(size)
    of_live = {"--size": size, "--reconnect": reconnect}
    if rate is not None and not 0 < rate <= 1000:
        raise AnyNetError(f"expected a rate above 0, up to 1000 frames per second, got {rate:g}")
    if split and right is not None:
        raise AnyNetError("--split is for one source that has both images side by side, got two")
    if topics is not None and topic is not None:
        raise AnyNetError("expected --topics, or --topic with --split, got both")
    if _is_recording(source):
        _refuse(of_live, "live sources", source)
        if right is not None:
            raise AnyNetError(f"expected no RIGHT beside the recording {source}, which has both; see --topics")
        if split and slop is not None:
            raise AnyNetError("--slop is for recordings of two topics, and --split for those of one: got both")
        named = (topics or ()) if topic is None else (topic,)
        return Recording(source, named, split, 0.01 if slop is None else slop)
    _refuse({"--topics": topics, "--topic": topic, "--slop": slop}, "ROS bags and MCAP files", source)
    if not split and right is None:
        raise AnyNetError(
            f"{source}: expected RIGHT too, or --split for images side by side, or a ROS bag or MCAP file"
        )
    names = [source] if right is None else [source, right]
    live = [_is_live(name) for name in names]
    if any(live) != all(live):
        raise AnyNetError(f"expected two live sources or two recorded ones, got {' and '.join(names)}")
    if live[0]:
        return Capture(names, True, rate, asked, 10.0 if reconnect is None else reconnect)
    _refuse(of_live, "live sources", source)
    if any(_is_images(name) for name in names):
        pairs, alone = find_pairs(source, source if right is None else right)
        found = ImageFiles([(p.name, p.left, None if right is None else p.right) for p in pairs], rate)
        found.warnings += [f"{path}: no partner" for path in alone]
        return found
    return Capture(names, False, rate)


def size_of(text: str | None) -> tuple[int, int] | None:
    """Width and height out of WIDTHxHEIGHT."""
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not all(re.fullmatch("[1-9][0-9]{0,4}", side) for side in (width, height)):
        raise AnyNetError(f"{_FORMAT}, got {text}")
    return int(width), int(height)


def _refuse(options: Mapping[str, object], owner: str, source: str) -> None:
    """Raises AnyNetError if one is given that this source does not have."""
    for name, value in options.items():
        if value is not None:
            raise AnyNetError(f"{name} belongs to {owner}, got {source}")


def _is_recording(name: str) -> bool:
    return Path(name).suffix.lower() in _BAGS or os.path.exists(os.path.join(name, "metadata.yaml"))


def _is_live(name: str) -> bool:
    if name.isdecimal() or "://" in name:
        return True
    try:
        return stat.S_ISCHR(os.stat(name).st_mode)
    except (OSError, ValueError):  # ValueError: a name with a zero byte
        return name.startswith("/dev/video")


def _is_images(name: str) -> bool:
    if os.path.isdir(name) or (glob.has_magic(name) and not os.path.exists(name)):
        return True
    return Path(name).suffix.lower() in endings()
