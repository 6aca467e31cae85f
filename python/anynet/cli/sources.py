"""From what the user named, a camera, video, folder, pattern or recording, to a source of frames."""

from __future__ import annotations

import glob
import os
import re
import stat
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
    tuple[str, str] | None, typer.Option(help="Of a recording: left and right.", show_default="found by names")
]
Topic = Annotated[str | None, typer.Option(help="Of a recording with --split.", show_default="found")]
_SLOP, _RECONNECT = 0.01, 10.0
Slop = Annotated[
    float | None,
    typer.Option(
        min=0, help="Seconds that left and right images of a recording may be apart.", show_default=str(_SLOP)
    ),
]
Reconnect = Annotated[
    float | None,
    typer.Option(
        min=0, help="Seconds to go on trying to open a live source that stopped.", show_default=str(_RECONNECT)
    ),
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
        topics: of a recording, left and right; see `Recording`, as for `slop`.
        topic: of a recording that is `split`, in their place.
        reconnect: see `Capture`.

    Raises:
        AnyNetError: if it cannot be opened, or an option is not one of such a source.
    """
    from anynet.streams import Capture, ImageFiles, Recording

    asked = size_of(size)
    named = (topics or ()) if topic is None else (topic,)
    if rate is not None and not 0 < rate <= 1000:
        raise AnyNetError(f"expected a rate above 0, up to 1000 frames per second, got {rate:g}")
    if split and right is not None:
        raise AnyNetError("--split is for one source that has both images side by side, got two")
    if topics and topic is not None:
        raise AnyNetError("--topic and --topics exclude each other")
    names = [source] if right is None else [source, right]
    live = [_is_live(name) for name in names]
    if not any(live) and (asked is not None or reconnect is not None):
        raise AnyNetError(f"--size and --reconnect belong to live sources, got {source}")
    if _is_recording(source):
        if right is not None:
            raise AnyNetError(f"expected no RIGHT beside the recording {source}, which has both; see --topics")
        return Recording(source, named, split, _SLOP if slop is None else slop)
    if named or slop is not None:
        raise AnyNetError(f"--topic, --topics and --slop belong to ROS bags and MCAP files, got {source}")
    if not split and right is None:
        raise AnyNetError(
            f"{source}: expected RIGHT too, or --split for images side by side, or a ROS bag or MCAP file"
        )
    if any(live) != all(live):
        raise AnyNetError(f"expected two live sources or two recorded ones, got {' and '.join(names)}")
    if live[0]:
        return Capture(names, True, rate, asked, _RECONNECT if reconnect is None else reconnect)
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
