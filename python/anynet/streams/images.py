"""Image files as a stream."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from anynet.errors import AnyNetError
from anynet.io import read_image, read_pair
from anynet.streams.source import Frame, Source, halves

RATE = 10.0  # frames per second


class ImageFiles(Source):
    """Pairs of image files, at a given rate.

    Args:
        pairs: name, left and right file of each frame; the right one None for side-by-side images.
        rate: frames per second; default: 10.
    """

    def __init__(self, pairs: Sequence[tuple[str, Path, Path | None]], rate: float | None = None) -> None:
        super().__init__()
        self.rate = rate or RATE
        self._pairs = pairs
        self.files = [file for _, *files in pairs for file in files if file is not None]
        self._closed = False

    @property
    def size(self) -> tuple[int, int] | None:
        _, left, right = self._pairs[0]
        try:
            height, width = read_image(left).shape[:2]
        except AnyNetError:  # told when the frame is read
            return None
        return width if right else width // 2, height

    def frames(self) -> Iterator[Frame]:
        begin, rate = time.time_ns(), self.rate or RATE
        for index, (name, left, right) in enumerate(self._pairs):
            if self._closed:
                return
            images = halves(read_image(left), str(left)) if right is None else read_pair(left, right)
            seconds = index / rate
            yield Frame(name, *images, stamp=begin + round(1e9 * seconds), time=seconds)

    def close(self) -> None:
        self._closed = True
