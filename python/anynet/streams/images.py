"""Image files as a stream."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from anynet.io import read_image, read_pair
from anynet.streams.source import Frame, Source, halves

RATE = 10.0  # frames per second where nobody says


class ImageFiles(Source):
    """Pairs of image files, at a given rate.

    Args:
        files: name, left and right file of each frame; the right one None for side-by-side images.
        rate: frames per second.
    """

    def __init__(self, files: Sequence[tuple[str, Path, Path | None]], rate: float = RATE) -> None:
        super().__init__()
        self.rate = rate
        self._files = files

    def frames(self) -> Iterator[Frame]:
        begin = time.time_ns()
        for index, (name, left, right) in enumerate(self._files):
            images = halves(read_image(left), str(left)) if right is None else read_pair(left, right)
            seconds = index / (self.rate or RATE)
            yield Frame(name, *images, stamp=begin + round(1e9 * seconds), time=seconds)
