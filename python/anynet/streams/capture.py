"""Cameras, network streams and video files, through OpenCV."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from anynet.errors import AnyNetError
from anynet.io.files import check_regular
from anynet.shutdown import computing
from anynet.streams.source import Frame, Image, Source, check_rate, left_and_right

RATE = 30.0  # frames per second of a video that does not say
_SAME_RATE = 0.01  # of a rate, that another may be apart: 30 and 29.97 are meant to be one
_COUNTED = {".avi", ".mp4", ".m4v", ".mov"}  # hold the number of their frames; of others OpenCV guesses it
_DIGITS = 4  # of a camera's index
_PAUSE = 0.5  # seconds between two attempts to reconnect
_TIMEOUT_MS = 5000  # for opening and reading network streams: a stop must not wait for longer


class Device(Protocol):
    """The part of `cv2.VideoCapture` that is used."""

    def isOpened(self) -> bool: ...
    def grab(self) -> bool: ...
    def retrieve(self) -> tuple[bool, np.ndarray]: ...
    def get(self, key: int) -> float: ...
    def set(self, key: int, value: float) -> bool: ...
    def release(self) -> None: ...


def open_device(name: str) -> Device:
    """A camera by its index or device file, a network stream by its address, or a video file."""
    if name.isdecimal():
        if len(name) > _DIGITS:
            raise AnyNetError(f"expected the index of a camera, got {name}")
        return cv2.VideoCapture(int(name))
    if "://" in name:
        parameters = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _TIMEOUT_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _TIMEOUT_MS]
        return cv2.VideoCapture(name, cv2.CAP_FFMPEG, parameters)
    return cv2.VideoCapture(name)


class Capture(Source):
    """One camera or video with both images side by side, or two with one image each.

    Two cameras are asked for their images at once, but nothing synchronizes their shutters. A live source that stops is
    opened again for as long as `reconnect` says.

    Args:
        names: of the camera or video, or of the left and the right one; see `open_device`.
        live: a camera or network stream, not a file.
        rate: frames per second; of a camera it is asked for, of a video it replaces the file's.
        size: width and height that cameras are asked for, of one image as it comes.
        reconnect: seconds to go on trying.
        open: opens a device.

    Raises:
        AnyNetError: if one cannot be opened, or an argument is not that.
    """

    def __init__(
        self,
        names: Sequence[str],
        live: bool,
        rate: float | None = None,
        size: tuple[int, int] | None = None,
        reconnect: float = 10.0,
        open: Callable[[str], Device] = open_device,
    ) -> None:
        super().__init__()
        check_rate(rate)
        if isinstance(names, str) or len(names) not in (1, 2):
            raise AnyNetError(f"expected the names of one or two cameras or videos, got {names!r}")
        self.live = live
        self._names = names
        self._size = size
        self._reconnect = reconnect
        self._open = open
        self._closed = threading.Event()
        self._asked_rate = rate
        self._devices = self._open_all()
        own = self._devices[0].get(cv2.CAP_PROP_FPS)
        self.rate = rate or (own if 0 < own < 1000 else None) or (None if live else RATE)
        counts = [0 if live else int(device.get(cv2.CAP_PROP_FRAME_COUNT)) for device in self._devices]
        if not live and len(names) == 2:
            both = " and ".join(names)
            if counts[0] != counts[1]:
                self.warnings.append(f"{both} have {counts[0]} and {counts[1]} frames")
            rates = [device.get(cv2.CAP_PROP_FPS) for device in self._devices]
            if min(rates) > 0 and max(rates) > (1 + _SAME_RATE) * min(rates):
                self.warnings.append(
                    f"{both} have {rates[0]:g} and {rates[1]:g} frames per second, and are paired frame by frame"
                )
        told = [n for n, name in zip(counts, names, strict=True) if n > 0 and Path(name).suffix.lower() in _COUNTED]
        self._count = min(told, default=0)  # of frames; 0: not known

    @property
    def size(self) -> tuple[int, int] | None:
        width, height = (int(self._devices[0].get(k)) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        return (width // (3 - len(self._devices)), height) if width > 1 and height > 0 else None

    def frames(self) -> Iterator[Frame]:
        if not (self.live or self._closed.is_set() or all(device.isOpened() for device in self._devices)):
            self._devices = self._open_all()  # a video that was read begins again
        try:
            yield from self._frames()
        finally:
            for device in self._devices:
                device.release()

    def close(self) -> None:
        """Ends `frames`, after the image that it waits for."""
        self._closed.set()

    def _frames(self) -> Iterator[Frame]:
        begin_ns, begin, index = time.time_ns(), time.monotonic(), 0
        while not self._closed.is_set():
            with computing():  # the interpreter must not end in OpenCV's C++ either
                images = self._read()
            if images is None:
                if not self.live:
                    if index == 0:
                        raise AnyNetError(f"cannot read {' and '.join(self._names)}: no frame that can be decoded")
                    if index < self._count - 1:  # some containers count one too many
                        raise AnyNetError(
                            f"{' and '.join(self._names)}: expected {self._count} frames, got {index}: "
                            "damaged or cut off there"
                        )
                    return
                images = self._read_again()
                if images is None:
                    return
            left, right = left_and_right(images, " and ".join(self._names))
            seconds = time.monotonic() - begin if self.live else index / (self.rate or RATE)
            yield Frame(f"{index:06}", left, right, begin_ns + round(1e9 * seconds), seconds)
            index += 1

    def _open_all(self) -> list[Device]:
        devices: list[Device] = []
        for name in self._names:
            if not self.live:
                check_regular(name)
            with computing():
                device = self._open(name)
            devices.append(device)
            if not device.isOpened():
                for opened in devices:
                    opened.release()
                what = "camera" if name.isdecimal() or name.startswith("/dev/") else "video"
                raise AnyNetError(f"cannot open {name}: no such {what}, or it is in use or of an unknown format")
            if self.live:
                wanted = {cv2.CAP_PROP_BUFFERSIZE: 1.0}  # where the driver can: the newest image, not the oldest
                if self._size is not None:
                    wanted |= {cv2.CAP_PROP_FRAME_WIDTH: self._size[0], cv2.CAP_PROP_FRAME_HEIGHT: self._size[1]}
                if self._asked_rate is not None:
                    wanted[cv2.CAP_PROP_FPS] = self._asked_rate
                for key, value in wanted.items():
                    device.set(key, value)
        return devices

    def _read(self) -> list[Image] | None:
        """All devices' images as RGB, taken as close together as can be; None if one has none."""
        if not all([device.grab() for device in self._devices]):
            return None
        images: list[Image] = []
        for device in self._devices:
            read, image = device.retrieve()
            if not read or image is None or image.size == 0:
                return None
            if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
                raise AnyNetError(f"{self._names[0]}: expected images of 8 bits, got {image.dtype} {list(image.shape)}")
            code = cv2.COLOR_GRAY2RGB if image.ndim == 2 else cv2.COLOR_BGR2RGB
            images.append(np.asarray(cv2.cvtColor(image, code), np.uint8))
        return images

    def _read_again(self) -> list[Image] | None:
        """The next images of a source that stopped; None if it was closed meanwhile."""
        for device in self._devices:
            device.release()
        end = time.monotonic() + self._reconnect
        while time.monotonic() < end:
            if self._closed.wait(min(_PAUSE, self._reconnect)):
                return None
            try:
                self._devices = self._open_all()
            except AnyNetError:
                continue
            with computing():
                images = self._read()
            if images is not None:
                return images
            for device in self._devices:
                device.release()
        names = " and ".join(self._names)
        raise AnyNetError(f"{names}: no image any more, and none for {self._reconnect:g} s of trying again")
