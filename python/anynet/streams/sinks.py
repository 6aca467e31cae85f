"""Where a stream's results go, beside files: a recording of ROS messages, a video."""

from __future__ import annotations

import os
import secrets
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError
from anynet.io.depth import millimeters
from anynet.io.files import reason
from anynet.streams.ros import CAMERA_INFO, CLOUD, DISPARITY, IMAGE, Messages, require_rosbags
from anynet.streams.stream import Result
from anynet.trust import within_reach
from anynet.visualize import colorize, limits_of

if TYPE_CHECKING:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Writer as Writer2

DEPTH_ENCODINGS = "32FC1", "16UC1"
_FRAME_ID = "camera_left_optical_frame"  # where the source has none
_CALM = 0.9  # share of the limits of a video's colors that stays from frame to frame
_GAP = 10.0  # seconds; a video does not stand still for longer
_RATES = 1 / _GAP, 1000.0  # frames per second
_TICKS = 65535  # most that MPEG-4 holds, and OpenCV makes a decimal fraction of the rate


class Sink(ABC):
    """Takes results, and is closed at the end, also after an error: what came until then stays readable."""

    @abstractmethod
    def write(self, result: Result) -> None:
        """Takes a result.

        Raises:
            AnyNetError: if it cannot be written, or the sink is closed.
        """

    @abstractmethod
    def close(self) -> None:
        """Completes what was written; done again, nothing."""

    def __enter__(self) -> Sink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class Recorder(Sink):
    """ROS messages, with the frames' stamps and frame ids, in a file that is named when it is complete.

    * NAMESPACE/disparity: stereo_msgs/DisparityImage, NaN where unknown; adjusted for doffs, as its definition says
    * of estimates with confidence: NAMESPACE/left/confidence (sensor_msgs/Image, 32FC1, 0 to 1) and
      NAMESPACE/left/occluded (mono8, 255 where the right camera does not see the point)
    * with a calibration: NAMESPACE/left/depth (sensor_msgs/Image, 32FC1 in meters with NaN where unknown, or 16UC1 in
      millimeters with 0, as REP 118), NAMESPACE/points (PointCloud2), NAMESPACE/left/camera_info and right/camera_info

    Args:
        path: FILE.mcap; FILE.bag (ROS 1); else the folder of a ROS 2 bag. Must not exist.
        depth_encoding: "32FC1" or "16UC1".
        max_depth: meters; points beyond are left out of the cloud; None: what half a pixel of error tells to 20 %.
        namespace: of the topics.

    Raises:
        AnyNetError: if the path exists or cannot be made, or `rosbags` is missing.
    """

    def __init__(
        self,
        path: str | Path,
        depth_encoding: str = "32FC1",
        max_depth: float | None = None,
        namespace: str = "/stereo",
    ) -> None:
        require_rosbags()
        if depth_encoding not in DEPTH_ENCODINGS:
            raise AnyNetError(f"expected a depth encoding of {' or '.join(DEPTH_ENCODINGS)}, got {depth_encoding}")
        self._path = Path(path)
        _check_new(self._path)
        self._depth_encoding = depth_encoding
        self._max_depth = max_depth
        self._namespace = namespace
        self._part = _unfinished(self._path)
        self._ending = self._path.suffix.lower()
        self._messages = Messages(1 if self._ending == ".bag" else 2)
        self._topics: dict[str, Any] = {}
        self._closed = self._cut_off = False
        with _told(self._path):
            self._writer = self._open()

    def _open(self) -> Writer1 | Writer2:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        writer: Writer1 | Writer2
        if self._messages.ros == 1:
            writer = Writer1(self._part)
        else:
            plugin = StoragePlugin.MCAP if self._ending == ".mcap" else StoragePlugin.SQLITE3
            # The name inside is kept when the folder gets its own.
            self._part.mkdir()
            writer = Writer2(self._part / self._path.name, version=8, storage_plugin=plugin)
        writer.open()
        self._database = getattr(getattr(writer, "storage", None), "conn", None)
        if self._database is not None:  # else the commit of each frame would wait for the disk
            self._database.execute("PRAGMA synchronous = OFF")
        return writer

    def write(self, result: Result) -> None:
        _check_open(self._path, self._closed or self._cut_off)
        frame, calibration, messages = result.frame, result.pair.calibration, self._messages
        header = messages.header(frame.stamp, frame.frame_id or _FRAME_ID)
        disparity = result.estimate.disparity
        doffs, focal, baseline = 0.0, 0.0, 0.0
        if calibration is not None:
            doffs, focal, baseline = calibration.doffs, calibration.focal, calibration.baseline
        adjusted = disparity + np.float32(doffs)
        known = adjusted[np.isfinite(adjusted)]
        span = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        topics = {"disparity": (DISPARITY, messages.disparity(header, adjusted, focal, baseline, *span))}
        confidence, occluded = result.estimate.confidence, result.estimate.occluded
        if confidence is not None and occluded is not None:
            topics["left/confidence"] = IMAGE, messages.image(header, confidence, "32FC1")
            topics["left/occluded"] = IMAGE, messages.image(header, np.uint8(255) * occluded, "mono8")
        if calibration is not None:
            height, width = disparity.shape
            depth = calibration.depth(disparity)
            near = within_reach(depth, calibration, self._max_depth)
            points = calibration.points(depth)[near]
            for right, side in enumerate(("left", "right")):
                info = messages.camera_info(header, (width, height), calibration, right=bool(right))
                topics[f"{side}/camera_info"] = CAMERA_INFO, info
            values = depth if self._depth_encoding == "32FC1" else millimeters(depth)
            topics["left/depth"] = IMAGE, messages.image(header, values, self._depth_encoding)
            topics["points"] = CLOUD, messages.cloud(header, points, result.pair.left[near])
        with _told(self._path):  # what cannot be said spoils this frame alone
            serialized = {name: (kind, messages.serialize(message)) for name, (kind, message) in topics.items()}
        try:
            with _told(self._path):
                self._write(frame.stamp, serialized)
        except AnyNetError:
            self._cut_off = True
            raise

    def _write(self, stamp: int, topics: dict[str, tuple[str, Any]]) -> None:
        for name, (kind, data) in topics.items():
            if name not in self._topics:
                store = self._messages.store
                self._topics[name] = self._writer.add_connection(f"{self._namespace}/{name}", kind, typestore=store)
            self._writer.write(self._topics[name], stamp, data)
        if self._database is not None:
            self._database.commit()  # SQLite takes back, on a full disk, all that is not

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if self._cut_off:  # which was told; it keeps its unfinished name
            with suppress(Exception):
                if self._database is None:  # whose metadata would count messages that are not there
                    self._writer.close()
            with suppress(Exception):
                self._writer.abort()
            return
        with _told(self._path):
            self._writer.close()
            part = self._part
            if self._messages.ros == 2:
                part = part / self._path.name
                if self._ending == ".mcap":
                    part = part / f"{part.name}.mcap"
            if self._topics:
                os.replace(part, self._path)
            if self._messages.ros == 2:
                shutil.rmtree(self._part)
            else:
                self._part.unlink(missing_ok=True)


class Video(Sink):
    """A video of the left images and their disparities in colors; its colors' limits follow the scene slowly.

    A picture stays until the next result, so that the video runs as time did.

    Args:
        path: FILE.mp4. Must not exist.
        rate: frames per second.

    Raises:
        AnyNetError: if the path exists or has another ending.
    """

    def __init__(self, path: str | Path, rate: float) -> None:
        self._path = Path(path)
        if self._path.suffix.lower() != ".mp4":
            raise AnyNetError(f"{path}: expected a name ending in .mp4")
        _check_new(self._path)
        self._rate = _holdable(rate)
        self._part = _unfinished(self._path)
        self._writer: cv2.VideoWriter | None = None
        self._closed = False
        self._limits: tuple[float, float] | None = None
        self._begin = 0
        self._written = 0  # frames, and those left out where the video would stand still
        self._frames = 0

    def write(self, result: Result) -> None:
        _check_open(self._path, self._closed)
        picture = self._picture(result)
        height, width = picture.shape[:2]
        if self._writer is None:
            writer = cv2.VideoWriter(str(self._part), cv2.VideoWriter.fourcc(*"mp4v"), self._rate, (width, height))
            if not writer.isOpened():
                self._part.unlink(missing_ok=True)
                raise AnyNetError(f"cannot write {self._path}: OpenCV cannot make a video of {width} x {height} there")
            self._writer = writer
            self._begin = result.frame.stamp
        until = round((result.frame.stamp - self._begin) / 1e9 * self._rate) + 1
        times = min(max(1, until - self._written), max(1, round(_GAP * self._rate)))
        for _ in range(times):
            self._writer.write(picture)
        self._written = max(until, self._written + times)
        self._frames += times

    def _picture(self, result: Result) -> npt.NDArray[np.uint8]:
        """BGR; one above the other if they are wide; with even sides, as the codec wants."""
        limits = limits_of(result.estimate.disparity)
        if self._limits is not None:
            low, high = (_CALM * old + (1 - _CALM) * new for old, new in zip(self._limits, limits, strict=True))
            limits = low, high
        self._limits = limits
        both = result.pair.left, colorize(result.estimate.disparity, limits)
        height, width = both[0].shape[:2]
        picture = np.vstack(both) if width > 1.5 * height else np.hstack(both)
        odd = picture.shape[0] % 2, picture.shape[1] % 2
        return np.pad(picture[..., ::-1], ((0, odd[0]), (0, odd[1]), (0, 0)), mode="edge")

    def close(self) -> None:
        closed, self._closed = self._closed, True
        if closed or self._writer is None:
            return
        self._writer.release()
        found = max(0, int(cv2.VideoCapture(str(self._part)).get(cv2.CAP_PROP_FRAME_COUNT)))
        if found != self._frames:  # OpenCV's writer says nothing of a full disk
            raise AnyNetError(
                f"cannot write {self._path}: expected {self._frames} frames, got {found} (is the disk full?); "
                f"what there is of it: {self._part.name}"
            )
        with _told(self._path):
            os.replace(self._part, self._path)


def _holdable(rate: float) -> float:
    """The nearest rate that an MPEG-4 video of OpenCV's can have."""
    low, high = _RATES
    rate = min(max(rate, low), high)
    return next(near for digits in (3, 2, 1) if (near := round(rate, digits)) * 10**digits <= _TICKS)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Errors of files and of `rosbags` as one line."""
    try:
        yield
    except AnyNetError:
        raise
    except Exception as error:
        raise AnyNetError(f"cannot write {path}: {reason(error)}") from error


def _check_open(path: Path, closed: bool) -> None:
    if closed:
        raise AnyNetError(f"cannot write {path}: expected an open file, got one that is closed or was cut off")


def _check_new(path: Path) -> None:
    if os.path.lexists(path):
        raise AnyNetError(f"{path} exists: expected the name of a new file")
    if not path.parent.is_dir():
        raise AnyNetError(f"cannot write {path}: no folder {path.parent}")


def _unfinished(path: Path) -> Path:
    """In the same folder, so that it can be renamed, and with the same ending, which tells OpenCV the format."""
    return path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")
