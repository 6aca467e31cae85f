from __future__ import annotations

import os
import sqlite3
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anynet.camera import Calibration, StereoRig
from anynet.errors import AnyNetError
from anynet.streams import Frame, Recording, pairing, recording

pytest.importorskip("rosbags", reason="the extra ros is not installed")

from bags import START, BagWriter

MS = 1_000_000


def images(index: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(index)
    return tuple(rng.integers(0, 256, (2, 12, 20, 3), dtype=np.uint8))


def write(path: Path, left: str = "/cam/left/image_rect", right: str = "/cam/right/image_rect", count: int = 4,
          compression: str = "") -> Path:  # fmt: skip
    with BagWriter(path, compression) as bag:
        for index in range(count):
            for topic, image in zip((left, right), images(index), strict=True):
                bag.image(topic, image, START + 100 * MS * index, recorded=START + 100 * MS * index + 5 * MS)
    return path


def read(path: Path, **options: object) -> list[Frame]:
    with Recording(path, **options) as source:
        return list(source.frames())


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "folder"])
def test_kinds(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / name)
    frames = read(path)
    assert [frame.name for frame in frames] == ["000000", "000001", "000002", "000003"]
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal([frame.left, frame.right], images(index))
        assert (frame.stamp, frame.frame_id) == (START + 100 * MS * index, "eye")
        assert frame.time == pytest.approx(0.1 * index)
    if name == "folder":
        assert len(read(path / "folder.db3")) == 4
    with Recording(path) as source:
        assert source.rate == pytest.approx(10, rel=0.01)
        assert source.calibration is None


def test_endings_in_upper_case(tmp_path: Path) -> None:
    write(tmp_path / "a.bag").rename(tmp_path / "A.BAG")
    assert len(read(tmp_path / "A.BAG")) == 4
    for ending in ("mcap", "db3"):
        path = tmp_path / f"A.{ending.upper()}"
        with pytest.raises(AnyNetError, match=rf"A.*: expected the ending \.{ending} in lower case, got"):
            Recording(path)


def test_an_mcap_file_of_another_writer(tmp_path: Path) -> None:
    writer = pytest.importorskip("mcap_ros2.writer", reason="mcap-ros2-support is not installed")
    definition = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
    with open(tmp_path / "a.mcap", "wb") as file:
        mcap = writer.Writer(file)
        schema = mcap.register_msgdef("sensor_msgs/msg/Image", definition)
        for side, image in zip(("left", "right"), images(0), strict=True):
            header = {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "eye"}
            message = {"header": header, "height": 12, "width": 20, "encoding": "rgb8", "is_bigendian": 0, "step": 60}
            mcap.write_message(f"/{side}/image", schema, message | {"data": image.tobytes()}, START, START)
        mcap.finish()
    (frame,) = read(tmp_path / "a.mcap")
    np.testing.assert_array_equal([frame.left, frame.right], images(0))
    assert frame.stamp == 5_000_000_006


@pytest.mark.parametrize("profile", ["ros1", ""])
def test_ros_1_messages_in_mcap_are_refused(tmp_path: Path, profile: str) -> None:
    writer_of = pytest.importorskip("mcap.writer", reason="the mcap library is not installed").Writer
    path = tmp_path / "ros1.mcap"
    with open(path, "wb") as file:
        writer = writer_of(file)
        writer.start(profile=profile, library="test")
        schema = writer.register_schema(name="sensor_msgs/Image", encoding="ros1msg", data=b"uint32 height")
        for side in ("left", "right"):
            channel = writer.register_channel(topic=f"/{side}/image", message_encoding="ros1", schema_id=schema)
            writer.add_message(channel, log_time=1, publish_time=1, data=bytes(8))
        writer.finish()
    with pytest.raises(AnyNetError) as caught:
        Recording(path)
    message = "ROS 1 messages inside an MCAP file are not read: use the .bag, or convert it to ROS 2"
    assert str(caught.value) == f"{path}: {message}"


def test_compressed_and_side_by_side(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.compressed("/zed/image/compressed", np.hstack(images(0)), START)
    (frame,) = read(tmp_path / "a.mcap", split=True)
    np.testing.assert_array_equal([frame.left, frame.right], images(0))


@pytest.mark.parametrize(
    ("topics", "found"),
    [
        (["/left/image_raw", "/right/image_raw"], 0),
        (["/cam0/image_raw", "/cam1/image_raw"], 0),
        (["/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"], 0),
        (["/stereo/image_left", "/stereo/image_right"], 0),
        (["/l/image_mono", "/l/image_color", "/r/image_mono", "/r/image_color"], 1),
        (["/left/image_raw", "/left/image_rect", "/right/image_raw", "/right/image_rect"], 1),
        (["/left/image_rect/compressed", "/left/image_rect", "/right/image_rect/compressed", "/right/image_rect"], 1),
        (["/left/image", "/left/depth_image", "/right/image", "/right/depth_image"], 0),
        (["/left/image_raw", "/left/image_rectified", "/right/image_raw", "/right/image_rectified"], 1),
        (["/left/direct/image", "/left/rectified/image", "/right/direct/image", "/right/rectified/image"], 1),
    ],
)
def test_topics_are_found_by_their_names(tmp_path: Path, topics: list[str], found: int) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for topic in topics:
            bag.image(topic, images(0)[0], START)
    with Recording(tmp_path / "a.mcap") as source:
        assert source.topics == [topics[found], topics[found + len(topics) // 2]]


def test_topics_that_cannot_be_told(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for topic in ("/front/left/image", "/front/right/image", "/rear/left/image", "/rear/right/image"):
            bag.image(topic, images(0)[0], START)
    with pytest.raises(AnyNetError, match=r"cannot tell the topics of the images; name 2 .*/front/left/image, "):
        Recording(tmp_path / "a.mcap")
    named = "/rear/left/image", "/rear/right/image"
    assert len(read(tmp_path / "a.mcap", topics=named)) == 1
    with pytest.raises(AnyNetError, match="no images on /none; there are some on /front/left/image"):
        Recording(tmp_path / "a.mcap", ("/none", "/rear/left/image"))
    for two in (named, named[:1] * 2):
        with pytest.raises(AnyNetError, match="expected one topic, with both images side by side, got /rear/left/"):
            Recording(tmp_path / "a.mcap", two, split=True)
    with BagWriter(tmp_path / "b.mcap") as bag:
        bag.camera_info("/left/camera_info", (1, 1), np.eye(3), [], np.eye(3), np.eye(3, 4))
    with pytest.raises(AnyNetError, match="no topic with images"):
        Recording(tmp_path / "b.mcap")


def test_left_and_right_are_matched_by_their_stamps(tmp_path: Path) -> None:
    """Shutters 3 ms apart, images that come late, and some without a partner."""
    with BagWriter(tmp_path / "a.mcap") as bag:
        stamps = ["l0", "r3", "l100", "l200", "r203", "r303", "l400", "l500", "r403", "r503"]
        for recorded, (side, *digits) in enumerate(stamps):
            stamp = int("".join(digits))
            image = np.full((4, 4, 3), stamp // 100, np.uint8)
            topic = {"l": "/left/image", "r": "/right/image"}[side]
            bag.image(topic, image, START + stamp * MS, recorded=START + recorded * MS)
    with pytest.warns(UserWarning, match=r"a\.mcap: 1 left and 1 right images had no partner within 10 ms \(--slop\)$"):
        frames = read(tmp_path / "a.mcap")
    assert [frame.stamp - START for frame in frames] == [0, 200 * MS, 400 * MS, 500 * MS]
    for frame in frames:
        np.testing.assert_array_equal(frame.left, frame.right)
    with pytest.raises(AnyNetError, match=r"no left and right image within 1 ms; the closest two are 3.0 ms apart"):
        read(tmp_path / "a.mcap", slop=0.001)


def late(path: Path, delay: int, count: int = 30) -> Path:
    """Pairs of one stamp at 30 per second, whose right images but the first are recorded `delay` frames later."""
    with BagWriter(path) as bag:
        times = [(index + side * delay * (index > 0), index, side) for index in range(count) for side in (0, 1)]
        for recorded, index, side in sorted(times):
            image = np.full((4, 4, 3), index, np.uint8)
            stamp, at = START + 33 * MS * index, START + 33 * MS * recorded
            bag.image(("/left/image", "/right/image")[side], image, stamp, recorded=at)
    return path


def test_images_wait_for_partners_that_come_late(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    with Recording(late(tmp_path / "a.mcap", delay=20)) as source:
        frames = list(source.frames())
        assert source.unpaired == (0, 0)
    assert [frame.left[0, 0, 0] for frame in frames] == list(range(30))
    assert all((frame.left == frame.right).all() for frame in frames)
    assert not recwarn


@pytest.mark.parametrize("bound", ["_WAIT", "_WAITING", "_WAITING_BYTES"])
def test_images_that_wait_in_vain_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bound: str) -> None:
    """For longer than a driver takes, or too many for the memory."""
    monkeypatch.setattr(pairing, bound, {"_WAIT": 5 * 33 * MS, "_WAITING": 6, "_WAITING_BYTES": 700}[bound])
    path = late(tmp_path / "a.mcap", delay=5)
    assert len(read(path)) == 30
    source = Recording(late(tmp_path / "b.mcap", delay=10))
    with pytest.warns(UserWarning, match="left and .* right images had no partner"):
        frames = list(source.frames())
    assert 1 <= len(frames) < 10
    assert source.unpaired == (30 - len(frames), 30 - len(frames))
    assert all((frame.left == frame.right).all() for frame in frames)


def test_frames_before_a_damaged_message_come_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those that wait for a left image that found no partner yet."""
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.image("/left/image", images(0)[0], START)
        for index in range(1, 6):
            for side, image in zip(("left", "right"), images(index), strict=True):
                bag.image(f"/{side}/image", image, START + 100 * MS * index)
    whole, calls = recording.deserialized, iter(range(100))

    def deserialized(*arguments: Any) -> Any:
        if next(calls) == 9:
            raise AnyNetError("damaged")
        return whole(*arguments)

    monkeypatch.setattr(recording, "deserialized", deserialized)
    frames: list[Frame] = []
    with pytest.raises(AnyNetError, match="damaged"):
        frames.extend(Recording(tmp_path / "a.mcap").frames())
    assert [frame.stamp - START for frame in frames] == [100 * MS * index for index in (1, 2, 3, 4)]


@pytest.mark.parametrize("slop", [-1, 1e300, float("inf"), float("nan")])
def test_slop_that_cannot_be(tmp_path: Path, slop: float) -> None:
    with pytest.raises(AnyNetError, match=r"^expected slop from 0 to 3600 seconds, got "):
        Recording(write(tmp_path / "a.mcap"), slop=slop)


def test_a_recording_of_one_topic_twice(tmp_path: Path) -> None:
    with pytest.raises(AnyNetError, match="expected two different topics, left and right, got /cam/left/image_rect, "):
        Recording(write(tmp_path / "a.mcap"), ["/cam/left/image_rect"] * 2)


def test_a_stamp_of_0_is_replaced(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for side in ("left", "right"):
            bag.image(f"/{side}/image", images(0)[0], 0, recorded=START)
    assert [frame.stamp for frame in read(tmp_path / "a.mcap")] == [START]


GRAY = np.arange(96, dtype=np.uint8).reshape(8, 12)


@pytest.mark.parametrize(
    ("encoding", "stored", "expected"),
    [
        ("mono8", GRAY, GRAY),
        ("8UC1", GRAY, GRAY),
        ("mono16", GRAY.astype(np.uint16) * 257, None),
        ("16UC1", GRAY.astype(np.uint16) * 16, None),  # 12 bits
        ("bgr8", np.dstack([GRAY, GRAY + 1, GRAY + 2]), np.dstack([GRAY + 2, GRAY + 1, GRAY])),
        ("bgra8", np.dstack([GRAY, GRAY + 1, GRAY + 2, GRAY]), np.dstack([GRAY + 2, GRAY + 1, GRAY])),
        ("rgba8", np.dstack([GRAY, GRAY + 1, GRAY + 2, GRAY]), np.dstack([GRAY, GRAY + 1, GRAY + 2])),
    ],
)
def test_encodings(tmp_path: Path, encoding: str, stored: np.ndarray, expected: np.ndarray | None) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for side in ("left", "right"):
            bag.image(f"/{side}/image", stored, START, encoding)
    (frame,) = read(tmp_path / "a.mcap")
    if expected is None:  # scaled by the bits that are used
        used = 4096 if encoding == "16UC1" else 65536
        expected = np.round(stored * (255 / ({4096: 2**12, 65536: 2**16}[used] - 1)))
    expected = expected if expected.ndim == 3 else np.dstack([expected] * 3)
    np.testing.assert_allclose(frame.left, expected, atol=0.51)
    np.testing.assert_array_equal(frame.left, frame.right)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns(tmp_path: Path, pattern: str, bits: int, compressed: bool) -> None:
    """A red image, seen through the pattern."""
    red = np.array([100 * (letter == "r") for letter in pattern], np.uint8).reshape(2, 2)
    mosaic, encoding = np.tile(red, (6, 8)), f"bayer_{pattern}{bits}"
    mosaic = mosaic.astype(np.uint16) * 257 * 2 if bits == 16 else mosaic
    with BagWriter(tmp_path / "a.mcap") as bag:
        for side in ("left", "right"):
            if compressed:
                bag.compressed(f"/{side}/image/compressed", mosaic, START, format=f"{encoding}; png compressed ")
            else:
                bag.image(f"/{side}/image", mosaic, START, encoding)
    (frame,) = read(tmp_path / "a.mcap")
    expected = [200 if bits == 16 else 100, 0, 0]
    np.testing.assert_array_equal(frame.left[3:-3, 3:-3].reshape(-1, 3).mean(axis=0), expected)


@pytest.mark.parametrize(
    ("format", "stored"),
    [
        ("bgr8; jpeg compressed bgr8", np.dstack([GRAY, GRAY + 1, GRAY + 2])),
        ("bayer_rggb8; jpeg compressed bgr8", np.dstack([GRAY, GRAY, GRAY])),  # demosaiced before it was compressed
        ("bayer_rggb8; png compressed ", np.dstack([GRAY, GRAY + 1, GRAY + 2])),
        ("mono8; png compressed", GRAY),
        ("mono16; png compressed", GRAY.astype(np.uint16) * 257),
        ("16UC1; png compressed mono16", GRAY.astype(np.uint16) * 257),
        ("", GRAY),
    ],
)
def test_formats_of_image_transport(tmp_path: Path, format: str, stored: np.ndarray) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for side in ("left", "right"):
            bag.compressed(f"/{side}/image/compressed", stored, START, format=format)
    (frame,) = read(tmp_path / "a.mcap")
    expected = stored // 257 if stored.dtype == np.uint16 else stored
    np.testing.assert_array_equal(frame.left, expected if expected.ndim == 3 else np.dstack([expected] * 3))


def test_rows_that_are_padded_and_bytes_the_other_way_round(tmp_path: Path) -> None:
    padded = np.zeros((8, 16), np.uint8)
    padded[:, :12] = GRAY
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.image("/left/image", padded[:, :12], START, "mono8", step=16, data=padded.reshape(-1)[: 7 * 16 + 12])
        big = (GRAY.astype(">u2") * 257).view(np.uint8).reshape(-1)
        bag.image("/right/image", GRAY, START, "mono16", step=24, data=big, is_bigendian=1)
    (frame,) = read(tmp_path / "a.mcap")
    np.testing.assert_array_equal(frame.left[..., 0], GRAY)
    np.testing.assert_array_equal(frame.right[..., 0], GRAY)


@pytest.mark.parametrize(
    "lie",
    [
        {"height": 10**6},
        {"width": 2**31},
        {"step": 1},
        {"encoding": "jpeg"},
        {"data": np.zeros(0, np.uint8)},
        {"width": 0},
        {"encoding": "mono16"},
    ],
)
def test_images_that_lie(tmp_path: Path, lie: dict[str, object]) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for side in ("left", "right"):
            bag.image(f"/{side}/image", GRAY, START, **({"encoding": "mono8"} | lie))
    with pytest.raises(AnyNetError, match=r"a\.mcap: image 0 of /left/image: expected ") as caught:
        read(tmp_path / "a.mcap")
    assert "\n" not in str(caught.value)


def test_the_step_of_one_row_means_nothing(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for side in ("left", "right"):
            bag.image(f"/{side}/image", GRAY[:1], START, "mono8", step=2**32 - 1)
    (frame,) = read(tmp_path / "a.mcap")
    np.testing.assert_array_equal(frame.left[..., 0], GRAY[:1])


def test_sizes_of_left_and_right_differ_and_damaged_jpegs(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.image("/left/image", GRAY, START, "mono8")
        bag.image("/right/image", GRAY[:, 1:].copy(), START, "mono8")
    with pytest.raises(AnyNetError, match="expected two images of one size, got 12 x 8 and 11 x 8"):
        read(tmp_path / "a.mcap")
    for data in (b"", b"\xff\xd8\xff garbage"):
        path = tmp_path / f"{len(data)}.mcap"
        with BagWriter(path) as bag:
            for side in ("left", "right"):
                bag.compressed(f"/{side}/image/compressed", GRAY, START, data)
        with pytest.raises(AnyNetError, match=r"cannot read .*image 0 of /left/image/compressed: "):
            read(path)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3"])
def test_damaged_files_end_in_one_line(tmp_path: Path, name: str) -> None:
    """Cut off, flipped and replaced bytes: a reading that succeeds, or AnyNetError of one line."""
    whole = write(tmp_path / ("b" if name == "a.db3" else name))
    whole = whole / "b.db3" if name == "a.db3" else whole
    data = whole.read_bytes()
    path = tmp_path / f"damaged{whole.suffix}"
    rng = np.random.default_rng(0)
    told = []
    for trial in range(60):
        damaged = bytearray(data)
        if trial % 2:
            damaged = damaged[: rng.integers(len(damaged))]
        else:
            for place in rng.integers(0, len(damaged), 8):
                damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            read(path)
        except AnyNetError as error:
            told.append(str(error))
    assert len(told) > 5
    assert all(str(path) in message and "\n" not in message for message in told)
    with pytest.raises(AnyNetError, match="not a readable ROS bag or MCAP file"):
        Recording(tmp_path / f"none{whole.suffix}")


@pytest.mark.parametrize(
    ("name", "compression"),
    [("a.bag", "bz2"), ("a.bag", "lz4"), ("a.mcap", "storage"), ("folder", "message"), ("folder", "file")],
)
def test_compressed_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, compression: str) -> None:
    path = write(tmp_path / name, compression=compression)
    np.testing.assert_array_equal([(frame.left, frame.right) for frame in read(path)], [images(i) for i in range(4)])
    if compression != "file":
        monkeypatch.setenv("ANYNET_MAX_PIXELS", "50")
        with pytest.raises(AnyNetError, match=r"not a readable .*blocks of at most 400 bytes; ANYNET_MAX_PIXELS"):
            read(path)


def test_compressed_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What they unpack to is bounded for all together, however often each is named."""
    from rosbags.rosbag2.reader import zstd

    path = write(tmp_path / "folder", compression="file")
    file, metadata = path / "folder.db3.zstd", path / "metadata.yaml"
    (tmp_path / "zeros").write_bytes(bytes(2**24))
    with zstd.open(tmp_path / "zeros.zstd", "wb") as zeros:
        zeros.write(bytes(2**24))
    file.write_bytes(file.read_bytes() + (tmp_path / "zeros.zstd").read_bytes())
    assert file.stat().st_size < 2**14
    assert len(read(path)) == 4
    message = r"not a readable .*unpack to at most 32 times their size or 16960000 bytes; ANYNET_MAX_PIXELS raises"
    monkeypatch.setenv("ANYNET_MAX_PIXELS", str(1_060_000))
    assert len(read(path)) == 4
    metadata.write_text(
        metadata.read_text().replace("- folder.db3.zstd", "- folder.db3.zstd\n" + 9 * "  - folder.db3.zstd\n")
    )
    with pytest.raises(AnyNetError, match=message):
        read(path)


def altered(path: Path, *commands: str) -> Path:
    """The folder's database, changed by SQL."""
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as database, database:
        for command in commands:
            database.execute(command)
    return path


COUNTED = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {})"
STORED = "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
VIEW = ["DROP TABLE schema", f"CREATE VIEW schema AS {COUNTED.format(10**12)} SELECT count(*) AS schema_version FROM n"]
FUNCTION = ["ALTER TABLE messages RENAME TO old", f"{STORED} data AS (zeroblob(500000000)))"]
DOUBLED = ["ALTER TABLE messages RENAME TO old", f"{STORED} a TEXT, b AS (a || a), data AS (b || b))"]
JOINED = [  # topics and messages that all belong together
    "ALTER TABLE topics RENAME TO old",
    "CREATE TABLE topics (id, name, type, serialization_format, offered_qos_profiles, type_description_hash)",
    f"{COUNTED.format(5000)} INSERT INTO topics SELECT 1, name, type, serialization_format, '', '' FROM n, old "
    "WHERE id = 1",
    f"{COUNTED.format(5000)} INSERT INTO messages (topic_id, timestamp, data) SELECT 1, i, x'00' FROM n",
]


@pytest.mark.parametrize(
    ("commands", "message"),
    [
        (VIEW, "not authorized"),
        (FUNCTION, "without computed columns"),
        (DOUBLED, "without computed columns"),
        (JOINED, "interrupted"),
    ],
)
def test_databases_that_compute(tmp_path: Path, commands: list[str], message: str) -> None:
    folder = altered(write(tmp_path / "folder"), *commands)
    start = time.process_time()
    with pytest.raises(AnyNetError, match=rf"not a readable ROS bag or MCAP file \(.*{message}"):
        read(folder / "folder.db3")
    assert time.process_time() - start < 5


def test_a_large_database(tmp_path: Path) -> None:
    path = write(tmp_path / "folder") / "folder.db3"
    os.truncate(path, 5 * 2**30)  # which takes no space
    assert len(read(path)) == 4


def test_metadata(tmp_path: Path) -> None:
    """Of any type, and too large."""
    path = write(tmp_path / "folder")
    metadata = path / "metadata.yaml"
    text = metadata.read_text()
    for damaged in (
        text.replace("name: /cam/left/image_rect", "name: 5"),
        text.replace("name: /cam/left/image_rect", "name: [5]"),
        text.replace("message_count: 4", "message_count: many"),
        text + "#" * 2**20,
    ):
        assert damaged != text
        metadata.write_text(damaged)
        with pytest.raises(
            AnyNetError, match=r"folder: (not a readable ROS bag|no topic|cannot tell the topics)"
        ) as caught:
            read(path)
        assert "\n" not in str(caught.value)
    metadata.write_text(text)
    assert len(read(path)) == 4
    (path / "folder.db3").unlink()
    os.mkfifo(path / "folder.db3")
    with pytest.raises(AnyNetError, match=r"folder\.db3: expected a file, got a pipe"):
        read(path)


def test_profiles_of_quality_are_not_read(tmp_path: Path) -> None:
    """They are YAML, which takes long."""
    from rosbags.highlevel import AnyReader

    path = altered(write(tmp_path / "folder"), "UPDATE topics SET offered_qos_profiles = '['") / "folder.db3"
    assert len(read(path)) == 4
    with pytest.raises(Exception, match="offered_qos_profiles"), AnyReader([path]):  # elsewhere all is as it was
        pass


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_definitions_are_those_of_ros(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / name)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"uint32 height", b"uint32 h-ight"))
    assert path.read_bytes() != data
    assert len(read(path)) == 4


def test_digests_are_those_of_ros(tmp_path: Path) -> None:
    path, digest = write(tmp_path / "a.bag"), b"060021388200f6f0f447d0fcd9c64743"
    path.write_bytes(path.read_bytes().replace(digest, digest[:-1] + b"0"))
    with pytest.raises(AnyNetError, match=r"a\.bag: expected sensor_msgs/msg/Image with digest 06.*3, got '06.*0'"):
        read(path)
    path = altered(write(tmp_path / "folder"), "UPDATE topics SET type_description_hash = 'RIHS01_0'") / "folder.db3"
    with pytest.raises(AnyNetError, match=r"db3: expected sensor_msgs/msg/Image with digest RIHS01_d31.*'RIHS01_0'"):
        read(path)


RAW_K = np.array([[90.0, 0, 9], [0, 91, 6], [0, 0, 1]])


def with_infos(path: Path, topic: str, distortion: list[float], raw: np.ndarray = RAW_K) -> Path:
    """A rig with a baseline of 0.1 m whose right camera is turned by 0.02."""
    turned = np.array([[np.cos(0.02), 0, np.sin(0.02)], [0, 1, 0], [-np.sin(0.02), 0, np.cos(0.02)]])
    with BagWriter(path) as bag:
        for index, side in enumerate(("left", "right")):
            projection = np.array([[80.0, 0, 10 + index, -8.0 * index], [0, 80, 5, 0], [0, 0, 1, 0]])
            rotation = turned if index and distortion else np.eye(3)
            matrix = raw if distortion else projection[:, :3]
            bag.camera_info(f"/{side}/camera_info", (20, 12), matrix, distortion, rotation, projection)
            bag.image(f"/{side}/{topic}", images(0)[index], START)
    return path


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_calibration_of_rectified_images(tmp_path: Path, name: str) -> None:
    expected = Calibration(80, 0.1, cx=10, cy=5, doffs=1, size=(20, 12))
    for topic, distorted in (("image_rect", True), ("image_rectified", True), ("image_raw", False)):
        distortion = [0.1, 0, 0, 0, 0] if distorted else []
        with Recording(with_infos(tmp_path / f"{topic}_{name}", topic, distortion)) as source:
            assert isinstance(source.calibration, Calibration)
            for field, value in expected.values().items():
                assert source.calibration.values()[field] == pytest.approx(value), field


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_rig_of_raw_images(tmp_path: Path, name: str) -> None:
    with Recording(with_infos(tmp_path / name, "image_raw", [0.1, 0, 0, 0, 0])) as source:
        rig = source.calibration
    assert isinstance(rig, StereoRig)
    assert rig.baseline == pytest.approx(0.1)
    np.testing.assert_allclose(rig.left.matrix, RAW_K)
    assert rig.left.distortion[0] == 0.1
    assert rig.rectified == Calibration(80, 0.1, cx=10, cy=5, doffs=1, size=(20, 12))
    assert np.degrees(np.arccos((np.trace(rig.rotation) - 1) / 2)) == pytest.approx(np.degrees(0.02))


def test_cameras_with_skew(tmp_path: Path) -> None:
    """Only raw images suffer from it."""
    skewed = RAW_K + np.diag([0.5, 0], 1)
    with Recording(with_infos(tmp_path / "a.mcap", "image_rect", [0.1, 0, 0, 0, 0], skewed)) as source:
        assert isinstance(source.calibration, Calibration)
        assert source.warnings == []
    with Recording(with_infos(tmp_path / "b.mcap", "image_raw", [0.1, 0, 0, 0, 0], skewed)) as source:
        assert source.calibration is None
        (warning,) = source.warnings
    assert "b.mcap: expected a camera matrix without skew, got 0.5 beside focal lengths of 90 and 91" in warning


def test_cameras_that_are_hardly_calibrated(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for index, side in enumerate(("left", "right")):
            projection = np.array([[80.0, 0, 10, -8000.0 * index], [0, 80, 5 + 6 * index, 0], [0, 0, 1, 0]])
            bag.camera_info(f"/{side}/camera_info", (20, 12), projection[:, :3], [], np.eye(3), projection)
            bag.image(f"/{side}/image_rect", images(0)[index], START)
    with Recording(tmp_path / "a.mcap") as source:
        rows, long = source.warnings
    assert "a.mcap: the two cameras' rows do not agree: cy is 5 and 11" in rows
    assert "a.mcap: a baseline of 100 m is long: camera_info is in meters" in long


def test_cameras_that_are_not_calibrated(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as bag:
        for index, side in enumerate(("left", "right")):
            bag.camera_info(f"/{side}/camera_info", (20, 12), np.zeros((3, 3)), [], np.zeros((3, 3)), np.zeros((3, 4)))
            bag.image(f"/{side}/image", images(0)[index], START)
    with Recording(tmp_path / "a.mcap") as source:
        assert source.calibration is None
        (warning,) = source.warnings
    assert "not calibrated" in warning


def test_without_rosbags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.mcap")
    monkeypatch.setitem(__import__("sys").modules, "rosbags.typesys", None)
    with pytest.raises(AnyNetError, match=r"bags and MCAP files need the extra ros: pip install 'anynet\[ros\]'"):
        Recording(path)
