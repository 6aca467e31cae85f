"""What all sources of frames have in common."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from anynet.camera import Calibration, StereoRig
from anynet.errors import AnyNetError
from anynet.io.images import check_pair

Image = npt.NDArray[np.uint8]  # [H, W, 3] RGB

_PAUSE = 3600.0  # seconds between two frames; to wait for longer would look like hanging


@dataclass(frozen=True)
class Frame:
    """Two images taken at one time.

    Attributes:
        name: what its results are called.
        left, right: uint8 [H, W, 3] RGB.
        stamp: when they were taken, nanoseconds since 1970.
        time: when they come, seconds since the source's first frame; recordings are played by it.
        frame_id: the left camera's frame of coordinates, as ROS calls it.
    """

    name: str
    left: Image
    right: Image
    stamp: int
    time: float
    frame_id: str = ""


class Source(ABC):
    """Frames, one after the other. `close` it, or use it as a context manager.

    Attributes:
        live: frames come when they are taken, and those not fetched in time are lost; otherwise they wait.
        rate: frames per second, if known.
        calibration: what the source itself says about its cameras; a rig if its images are raw.
        warnings: what the user should know about it.
        files: the image files that it reads, if it reads such.
    """

    live = False
    rate: float | None = None
    calibration: Calibration | StereoRig | None = None
    files: Sequence[Path] = ()

    def __init__(self) -> None:
        self.warnings: list[str] = []

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of one image, if that can be told before the first frame."""
        return None

    @property
    def unpaired(self) -> tuple[int, int]:
        """How many left and right images of those read so far found no partner."""
        return 0, 0

    @abstractmethod
    def frames(self) -> Iterator[Frame]:
        """The frames, recorded ones from the first on each time; all of it on one thread.

        Raises:
            AnyNetError: if the source cannot be read any more, or gives what is no pair of images of one size.
        """

    @abstractmethod
    def close(self) -> None:
        """Lets go of files and devices; afterwards `frames` ends.

        May be called again, and from another thread than the one that reads `frames`.
        """

    def __enter__(self) -> Source:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def left_and_right(images: Sequence[Image], where: str) -> tuple[Image, Image]:
    """The two images, or the halves of the one that has both side by side.

    Raises:
        AnyNetError: if two differ in size, or the width of one is odd.
    """
    if len(images) == 2:
        left, right = images
        if left.shape != right.shape:
            sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in images)
            raise AnyNetError(f"{where}: expected two images of one size, got {sizes}")
        return left, right
    (image,) = images
    width = image.shape[1]
    if width % 2:
        raise AnyNetError(f"{where}: expected side-by-side images of even width, got {width} pixels")
    return np.ascontiguousarray(image[:, : width // 2]), np.ascontiguousarray(image[:, width // 2 :])


def check_source(source: object) -> None:
    """Raises AnyNetError if that is no source."""
    if not isinstance(source, Source):
        raise AnyNetError(f"expected a source of frames (anynet.streams.Source), got {type(source).__name__}")


def check_rate(rate: object) -> None:
    """Raises AnyNetError if that is neither None nor frames per second."""
    if rate is not None and not (isinstance(rate, Real) and not isinstance(rate, bool) and 0 < float(rate) < math.inf):
        raise AnyNetError(f"expected a rate > 0, got {rate!r}")


def check_frame(frame: Frame) -> None:
    """Raises AnyNetError if a source gave what is no frame of two images of one size."""
    if not isinstance(frame, Frame):
        raise AnyNetError(f"expected the source to give frames (anynet.streams.Frame), got {type(frame).__name__}")
    check_pair(frame.left, frame.right, f"frame {frame.name}: ")
    if not (isinstance(frame.time, Real) and math.isfinite(frame.time)):
        raise AnyNetError(f"frame {frame.name}: expected its time in seconds, got {frame.time!r}")


def check_pause(frame: Frame, before: float) -> None:
    """Raises AnyNetError if a frame that is played at its own pace comes unbelievably long after the one before."""
    if frame.time - before > _PAUSE:
        raise AnyNetError(
            f"frame {frame.name}: expected it within {_PAUSE:g} s of the one before, got {frame.time - before:g} s; "
            "with a rate (--rate) it does not matter"
        )
