"""Image files as a stream."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from anynet.errors import AnyNetError
from anynet.io.images import read_levels, to_8_bits, used_bits
from anynet.streams.source import Frame, Source, check_rate, left_and_right

RATE = 10.0  # frames per second


class ImageFiles(Source):
    """Pairs of image files, at a given rate.

    Args:
        pairs: name, left and right file of each frame; the right one None for side-by-side images.
        rate: frames per second; default: 10.

    Raises:
        AnyNetError: if there is no pair, or the rate is none.
    """

    def __init__(self, pairs: Sequence[tuple[str, Path, Path | None]], rate: float | None = None) -> None:
        super().__init__()
        check_rate(rate)
        if not pairs:
            raise AnyNetError("expected pairs of image files, got none")
        self.rate = rate or RATE
        self._pairs = pairs
        self.files = [file for _, *files in pairs for file in files if file is not None]
        self._closed = False

    @property
    def size(self) -> tuple[int, int] | None:
        _, left, right = self._pairs[0]
        try:
            height, width = read_levels(left).shape[:2]
        except AnyNetError:  # told when the frame is read
            return None
        return width if right else width // 2, height

    def frames(self) -> Iterator[Frame]:
        begin, rate, bits = time.time_ns(), self.rate or RATE, 8
        for index, (name, *files) in enumerate(self._pairs):
            if self._closed:
                return
            paths = [file for file in files if file is not None]
            levels = [read_levels(path) for path in paths]
            bits = max([bits, *map(used_bits, levels)])  # of both cameras alike, and without flicker
            images = left_and_right([to_8_bits(image, bits) for image in levels], " and ".join(map(str, paths)))
            seconds = index / rate
            yield Frame(name, *images, stamp=begin + round(1e9 * seconds), time=seconds)

    def close(self) -> None:
        self._closed = True
