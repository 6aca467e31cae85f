from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from anynet import Estimate
from anynet.streams import Frame, Source


class Stub:
    """A predictor: each stage's disparity is the stage's number plus the left image's first value."""

    def __init__(self, seconds: float = 0.0) -> None:
        self.seconds = seconds

    def stages(self, left: np.ndarray, right: np.ndarray) -> Iterator[Estimate]:
        for stage in range(1, 5):
            time.sleep(self.seconds)
            yield Estimate(stage, np.full(left.shape[:2], stage + float(left[0, 0, 0]), np.float32), 1.0 * stage)


class Frames(Source):
    """A source of given frames."""

    def __init__(self, frames: Iterable[Frame], live: bool = False) -> None:
        super().__init__()
        self.live = live
        self._frames = frames
        self.closed = threading.Event()

    def frames(self) -> Iterator[Frame]:
        for frame in self._frames:
            if self.closed.is_set():
                return
            yield frame

    def close(self) -> None:
        self.closed.set()


def frame(index: int, size: tuple[int, int] = (16, 24), time: float | None = None) -> Frame:
    """Frame number `index`, which is also the value of its pixels, 100 ms after the one before."""
    image = np.full((*size, 3), index % 200, np.uint8)
    stamp = 1_700_000_000_000_000_000 + 100_000_000 * index
    return Frame(f"{index:06}", image, image, stamp, 0.1 * index if time is None else time, "left_camera")


@pytest.fixture
def stub() -> Stub:
    return Stub()
