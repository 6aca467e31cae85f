"""ROS 1 and ROS 2 bags and MCAP files as a stream."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anynet.errors import AnyNetError, one_line
from anynet.io.files import check_regular
from anynet.io.images import to_8_bits, used_bits
from anynet.streams.bounded import BoundedPath, bound_rosbags, opening
from anynet.streams.pairing import Pair, Pairing, Recorded
from anynet.streams.ros import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    calibration_of,
    check_digest,
    deserialized,
    levels_of,
    require_rosbags,
    stamp_of,
)
from anynet.streams.source import Frame, Source, left_and_right

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

MAX_SLOP = 3600  # seconds
# What the names of one rig's topics differ in.
_SIDES = (("left", "right"), ("infra1", "infra2"), ("cam0", "cam1"), ("camera0", "camera1"), ("camera_0", "camera_1"),
          ("image_0", "image_1"), ("cam_0", "cam_1"), ("l", "r"))  # fmt: skip


class Recording(Source):
    """The images of two topics, or of one with both side by side.

    Left and right belong together if their stamps are each other's nearest and differ by `slop` at most, and they were
    recorded within 5 s, in whatever order. The stamp and frame id of a frame are its left image's; a stamp of 0 is
    replaced by the time of recording.

    Args:
        path: a `.bag`, `.mcap` or `.db3` file, or the folder of a ROS 2 bag.
        topics: of the left and right images; by default found by their names.
        split: one topic has both images side by side.
        slop: seconds.

    Raises:
        AnyNetError: if the file is no such recording, or the topics are not there or not to be told.
    """

    def __init__(self, path: str | Path, topics: Sequence[str] = (), split: bool = False, slop: float = 0.01) -> None:
        super().__init__()
        self._path = Path(path)
        check_regular(path)
        ending = self._path.suffix.lower()
        if ending in (".mcap", ".db3") and ending != self._path.suffix:  # rosbags goes by it
            raise AnyNetError(f"{path}: expected the ending {ending} in lower case, got {self._path.suffix}")
        self._ros = 1 if ending == ".bag" else 2
        if not 0 <= slop <= MAX_SLOP:
            raise AnyNetError(f"expected slop from 0 to {MAX_SLOP} seconds, got {slop:g}")
        self._slop = round(1e9 * slop)
        self._pairing = Pairing(self._slop)
        self._closed = False
        with self._opened() as reader:
            found = {connection.topic: connection.msgtype for connection in reader.connections}
            images = sorted(topic for topic, kind in found.items() if kind in (IMAGE, COMPRESSED))
            self.topics = self._choose(images, list(topics), split)
            counts = [sum(c.msgcount for c in reader.connections if c.topic == topic) for topic in self.topics]
            if not min(counts):
                raise AnyNetError(f"{path}: no image on {self.topics[counts.index(0)]}")
            seconds = reader.duration / 1e9
            self.rate = (counts[0] - 1) / seconds if seconds > 0 and counts[0] > 1 else None
            infos = self._camera_infos(reader)
        if len(infos) == 2:
            try:
                rectified = any(map(_is_rectified, self.topics))
                self.calibration, found_wrong = calibration_of(infos[0], infos[1], str(path), rectified)
                self.warnings += found_wrong
            except AnyNetError as error:
                self.warnings.append(str(error))

    @property
    def size(self) -> tuple[int, int] | None:
        with self._opened() as reader:
            wanted = [connection for connection in reader.connections if connection.topic == self.topics[0]]
            _, _, raw = next(reader.messages(connections=wanted))
            levels = levels_of(deserialized(self._ros, raw, wanted[0].msgtype), f"{self._path}: {self.topics[0]}")
        return levels.shape[1] // (3 - len(self.topics)), levels.shape[0]

    @property
    def unpaired(self) -> tuple[int, int]:
        return self._pairing.lost[0], self._pairing.lost[1]

    def frames(self) -> Iterator[Frame]:
        with self._opened() as reader:
            wanted = [connection for connection in reader.connections if connection.topic in self.topics]
            begin, latest, bits = None, 0, 8
            for index, (images, recorded) in enumerate(self._pairs(reader, wanted)):
                if self._closed:
                    return
                names = [f"{self._path}: image {index} of {topic}" for topic in self.topics]
                levels = [levels_of(message, name) for message, name in zip(images, names, strict=True)]
                bits = max([bits, *map(used_bits, levels)])  # of both cameras alike, and without flicker
                left, right = left_and_right([to_8_bits(image, bits) for image in levels], names[0])
                latest = max(latest, recorded)  # a pair waits for an older one
                begin = latest if begin is None else begin
                stamp = stamp_of(images[0]) or recorded
                frame_id = str(images[0].header.frame_id)
                yield Frame(f"{index:06}", left, right, stamp, (latest - begin) / 1e9, frame_id)

    def close(self) -> None:
        self._closed = True

    def _pairs(self, reader: Reader1 | Reader2, connections: Sequence[Any]) -> Iterator[tuple[list[Any], int]]:
        """The messages that belong together, and when the later one was recorded."""
        self._pairing = pairing = Pairing(self._slop)
        failure: Exception | None = None
        try:
            for connection, recorded, raw in reader.messages(connections=connections):
                if self._closed:
                    return
                message = deserialized(self._ros, raw, connection.msgtype)
                if len(self.topics) == 1:
                    yield [message], recorded
                    continue
                image = Recorded(stamp_of(message) or recorded, recorded, len(raw), message)
                for pair in pairing.add(self.topics.index(connection.topic), image):
                    yield _messages(pair)
        except Exception as error:  # after the frames before it
            failure = error
        yield from map(_messages, pairing.rest())
        if failure is not None:
            raise failure
        if len(self.topics) == 1:
            return
        within = f"within {self._slop / 1e6:g} ms"
        if (closest := pairing.closest) > self._slop:
            nearest = "" if closest == math.inf else f"; the closest two are {closest / 1e6:.1f} ms apart"
            raise AnyNetError(f"{self._path}: no left and right image {within}{nearest} (--slop)")
        if sum(self.unpaired) > 1:  # one, where the recording begins or ends between two
            left, right = self.unpaired
            warnings.warn(
                f"{self._path}: {left} left and {right} right images had no partner {within} (--slop)", stacklevel=2
            )

    @contextmanager
    def _opened(self) -> Iterator[Reader1 | Reader2]:
        require_rosbags()
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2

        bound_rosbags()
        path = BoundedPath(self._path)
        try:
            reader: Reader1 | Reader2 = Reader1(path) if self._ros == 1 else Reader2(path)
            with opening(path):
                reader.open()
            try:
                for connection in reader.connections:
                    if connection.msgtype in (IMAGE, COMPRESSED, CAMERA_INFO):
                        check_digest(self._ros, connection.msgtype, connection.digest, str(self._path))
                yield reader
            finally:
                reader.close()
        except AnyNetError:
            raise
        except Exception as error:  # a damaged file raises whatever its reader meets first
            raise self._unreadable(error) from error

    def _unreadable(self, error: Exception) -> AnyNetError:
        if "Profile is not ros2" in str(error) or error.args == ("ros1msg",):  # what rosbags says of such an MCAP file
            return AnyNetError(
                f"{self._path}: ROS 1 messages inside an MCAP file are not read: use the .bag, or convert it to ROS 2"
            )
        return AnyNetError(f"{self._path}: not a readable ROS bag or MCAP file ({one_line(error)})")

    def _choose(self, images: list[str], named: list[str], split: bool) -> list[str]:
        wanted = 1 if split else 2
        if named:
            missing = [topic for topic in named if topic not in images]
            if missing:
                raise AnyNetError(f"{self._path}: no images on {missing[0]}; there are some on {_listed(images)}")
            if len(named) != wanted or len(set(named)) != wanted:
                what = "one topic, with both images side by side" if split else "two different topics, left and right"
                raise AnyNetError(f"expected {what}, got {_listed(named)}")
            return named
        if not images:
            raise AnyNetError(f"{self._path}: no topic with images")
        seen = [topic for topic in images if not re.search("depth|disparity|mask|confidence|occluded", topic)]
        found = [[topic] for topic in seen] if split else _pairs_of(seen)
        if len(found) > 1:  # the rectified one, in color, as few bytes as can be
            best = max(_preference(topics) for topics in found)
            found = [topics for topics in found if _preference(topics) == best]
        if len(found) != 1:
            raise AnyNetError(
                f"{self._path}: cannot tell the topics of the images; name {wanted} (--topics) of {_listed(images)}"
            )
        return found[0]

    def _camera_infos(self, reader: Reader1 | Reader2) -> list[Any]:
        """The first message of each topic's camera, left and right; fewer where they are not recorded."""
        infos: list[Any] = []
        for topic in self.topics:
            name = topic.removesuffix("/compressed").rsplit("/", 1)[0] + "/camera_info"
            chosen = [c for c in reader.connections if c.topic == name and c.msgtype == CAMERA_INFO]
            if chosen:
                first = next(reader.messages(connections=chosen), None)
                infos += [] if first is None else [deserialized(self._ros, first[2], CAMERA_INFO)]
        return infos


def _messages(pair: Pair) -> tuple[list[Any], int]:
    return [image.message for image in pair], max(image.recorded for image in pair)


def _pairs_of(topics: list[str]) -> list[list[str]]:
    """Topics whose names differ in left and right alone."""
    pairs = []
    for topic in topics:
        for left, right in _SIDES:
            pattern = rf"(?<![a-zA-Z0-9]){left}(?![a-zA-Z0-9])"
            partner = re.sub(pattern, right, topic)
            if partner != topic and partner in topics:
                pairs.append([topic, partner])
                break
    return pairs


def _preference(topics: list[str]) -> tuple[bool, ...]:
    words = _words(topics[0])
    return _is_rectified(topics[0]), "color" in words, "mono" not in words, "compressed" not in words


def _is_rectified(topic: str) -> bool:
    return any(word.startswith("rect") for word in _words(topic))


def _words(topic: str) -> set[str]:
    return set(re.split(r"[/_]", topic))


def _listed(topics: list[str]) -> str:
    return ", ".join(topics) if topics else "none"
