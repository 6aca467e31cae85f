"""What is written is read back by libraries other than the one that wrote it, where there are such."""

from __future__ import annotations

import os
import resource
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from anynet import Estimate
from anynet.camera import Calibration, PreparedPair
from anynet.errors import AnyNetError
from anynet.io.depth import millimeters
from anynet.streams import Frame, Recorder, Recording, Result, Video
from anynet.trust import within_reach

pytest.importorskip("rosbags", reason="the extra ros is not installed")

CALIBRATION = Calibration(100.0, 0.12, cx=11.5, cy=7.25, doffs=3.0, size=(24, 16))
STAMPS = [1_700_000_000_123_456_789 + 50_000_001 * i for i in range(3)]


def results(calibration: Calibration | None = CALIBRATION) -> list[Result]:
    """Three frames whose disparity is known but for one corner; the depth is 12 / (disparity + 3) meters."""
    rng = np.random.default_rng(0)
    found = []
    for index, stamp in enumerate(STAMPS):
        left = rng.integers(0, 256, (16, 24, 3), dtype=np.uint8)
        disparity = rng.uniform(1, 20, (16, 24)).astype(np.float32)
        disparity[:4, :4] = np.nan
        disparity[8, 8] = -2.99  # 1200 m away
        frame = Frame(f"{index:06}", left, left, stamp, 0.0, "left_optical")
        found.append(Result(frame, PreparedPair(left, left, calibration), Estimate(4, disparity, 1.0)))
    return found


def record(path: Path, calibration: Calibration | None = CALIBRATION, **options: object) -> list[Result]:
    given = results(calibration)
    with Recorder(path, **options) as recorder:
        for result in given:
            recorder.write(result)
    return given


def depth_of(result: Result) -> np.ndarray:
    return 12 / (result.estimate.disparity + 3)


def check(result: Result, messages: dict[str, object], log_time: int, max_depth: float | None = None) -> None:
    """The messages of one frame, decoded by whichever library."""
    index = int(result.frame.name)
    assert log_time == STAMPS[index]
    for message in messages.values():
        stamp = message.header.stamp
        nanoseconds = getattr(stamp, "nanosec", None) if hasattr(stamp, "nanosec") else stamp.nsecs
        seconds = stamp.sec if hasattr(stamp, "sec") else stamp.secs
        assert 10**9 * seconds + nanoseconds == STAMPS[index]
        assert message.header.frame_id == "left_optical"
    disparity = messages["/stereo/disparity"]
    assert (disparity.image.encoding, disparity.image.width, disparity.image.height) == ("32FC1", 24, 16)
    values = np.frombuffer(bytes(disparity.image.data), "<f4").reshape(16, 24)
    np.testing.assert_allclose(values, result.estimate.disparity + 3, rtol=1e-6)
    assert disparity.f == 100
    baseline = disparity.T if hasattr(disparity, "T") else disparity.t
    np.testing.assert_allclose(disparity.f * baseline / values, depth_of(result), rtol=1e-5)
    assert disparity.min_disparity == np.nanmin(values)
    assert disparity.max_disparity == np.nanmax(values)
    depth = messages["/stereo/left/depth"]
    assert depth.encoding == "32FC1"
    assert depth.step == 4 * 24
    np.testing.assert_allclose(np.frombuffer(bytes(depth.data), "<f4").reshape(16, 24), depth_of(result), rtol=1e-5)
    cloud = messages["/stereo/points"]
    fields = [(field.name, field.offset, field.datatype, field.count) for field in cloud.fields]
    assert fields == [("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 12, 7, 1)]
    assert result.pair.calibration is not None
    near = within_reach(depth_of(result), result.pair.calibration, max_depth)
    assert near.any()
    assert (cloud.height, cloud.width, cloud.point_step) == (1, near.sum(), 16)
    points = np.frombuffer(bytes(cloud.data), [("xyz", "<f4", 3), ("rgb", "<u4")])
    rows, columns = np.nonzero(near)
    z = depth_of(result)[near]
    expected = np.stack([(columns - 11.5) * z / 100, (rows - 7.25) * z / 100, z], axis=1)
    np.testing.assert_allclose(points["xyz"], expected, rtol=1e-4)
    r, g, b = result.pair.left[near].astype(np.uint32).T
    np.testing.assert_array_equal(points["rgb"], (r << 16) | (g << 8) | b)
    for side, cx, tx in (("left", 11.5, 0.0), ("right", 14.5, -12.0)):
        info = messages[f"/stereo/{side}/camera_info"]
        p, d = (getattr(info, name if hasattr(info, name) else name.upper()) for name in "pd")
        np.testing.assert_allclose(np.reshape(p, (3, 4)), [[100, 0, cx, tx], [0, 100, 7.25, 0], [0, 0, 1, 0]])
        assert not np.any(d)
        assert (info.width, info.height) == (24, 16)


def test_mcap_by_the_mcap_library(tmp_path: Path) -> None:
    mcap = pytest.importorskip("mcap.reader", reason="the mcap library is not installed")
    ros2 = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
    path = tmp_path / "out.mcap"
    given = record(path)
    with open(path, "rb") as file:
        reader = mcap.make_reader(file, decoder_factories=[ros2.DecoderFactory()])
        frames: dict[int, dict[str, object]] = {}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema.encoding == "ros2msg"
            frames.setdefault(message.log_time, {})[channel.topic] = decoded
        assert reader.get_summary().statistics.message_count == 15
    assert sorted(frames) == STAMPS
    for result, (log_time, messages) in zip(given, sorted(frames.items()), strict=True):
        check(result, messages, log_time)
    assert os.listdir(tmp_path) == ["out.mcap"]


@pytest.mark.parametrize("name", ["out.bag", "folder", "again.mcap"])
def test_bags(tmp_path: Path, name: str) -> None:
    """ROS 2 bags by Python's own SQLite; the messages of all by rosbags."""
    from rosbags.highlevel import AnyReader

    path = tmp_path / name
    given = record(path)
    if name == "folder":
        with sqlite3.connect(path / "folder.db3") as database:
            stored = database.execute("SELECT name, type, COUNT(*) FROM messages JOIN topics ON topics.id = topic_id "
                                      "GROUP BY name").fetchall()  # fmt: skip
        assert ("/stereo/disparity", "stereo_msgs/msg/DisparityImage", 3) in stored
        assert len(stored) == 5
    frames: dict[int, dict[str, object]] = {}
    with AnyReader([path]) as reader:
        for connection, log_time, raw in reader.messages():
            frames.setdefault(log_time, {})[connection.topic] = reader.deserialize(raw, connection.msgtype)
    assert len(frames) == 3
    for result, (log_time, messages) in zip(given, sorted(frames.items()), strict=True):
        check(result, messages, log_time)
    assert os.listdir(tmp_path) == [name]


def test_ros1_bag_by_the_mcap_projects_message_decoder(tmp_path: Path) -> None:
    genpy = pytest.importorskip("mcap_ros1._vendor.genpy.dynamic", reason="mcap-ros1-support is not installed")
    from rosbags.rosbag1 import Reader

    record(tmp_path / "out.bag")
    with Reader(tmp_path / "out.bag") as reader:
        for connection, _, raw in reader.messages():
            if connection.topic == "/stereo/disparity":
                kind = "stereo_msgs/DisparityImage"
                message = genpy.generate_dynamic(kind, connection.msgdef.data)[kind]().deserialize(raw)
                assert (message.f, message.header.frame_id) == (100, "left_optical")
                break
        else:
            pytest.fail("no disparity in the bag")


@pytest.mark.parametrize("name", ["out.mcap", "out.bag"])
def test_confidence(tmp_path: Path, name: str) -> None:
    from rosbags.highlevel import AnyReader

    rng = np.random.default_rng(1)
    confidence, occluded = rng.random((16, 24), np.float32), rng.random((16, 24)) > 0.5
    with Recorder(tmp_path / name) as recorder:
        for result in results(None):
            estimate = replace(result.estimate, confidence=confidence, occluded=occluded)
            recorder.write(replace(result, estimate=estimate))
    with AnyReader([tmp_path / name]) as reader:
        messages = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
    images = {topic: message for topic, message in messages if topic != "/stereo/disparity"}
    assert len(messages) == 9
    assert images.keys() == {"/stereo/left/confidence", "/stereo/left/occluded"}
    sure, hidden = images["/stereo/left/confidence"], images["/stereo/left/occluded"]
    assert (sure.encoding, sure.step, hidden.encoding, hidden.step) == ("32FC1", 96, "mono8", 24)
    np.testing.assert_array_equal(sure.data.view("<f4").reshape(16, 24), confidence)
    np.testing.assert_array_equal(hidden.data.reshape(16, 24), np.where(occluded, 255, 0))


def test_millimeters_and_far_points(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    given = record(tmp_path / "out.mcap", depth_encoding="16UC1", max_depth=1.0)
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        messages = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    depth = messages["/stereo/left/depth"]
    assert (depth.encoding, depth.step) == ("16UC1", 48)
    levels = depth.data.view("<u2").reshape(16, 24)
    meters = depth_of(given[-1])
    assert not levels[~np.isfinite(meters)].any()
    assert levels[8, 8] == 0  # 1200 m
    known = np.isfinite(meters) & (meters < 65)
    np.testing.assert_allclose(levels[known], 1000 * meters[known], atol=0.51)
    assert messages["/stereo/points"].width == (meters <= 1).sum() > 0


def test_without_a_calibration_the_disparity_alone(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    given = record(tmp_path / "out.mcap", calibration=None)
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        assert [connection.topic for connection in reader.connections] == ["/stereo/disparity"]
        *_, (connection, _, raw) = reader.messages()
        message = reader.deserialize(raw, connection.msgtype)
    np.testing.assert_array_equal(message.image.data.view("<f4").reshape(16, 24), given[-1].estimate.disparity)
    assert (message.f, message.t) == (0, 0)


def test_a_recording_is_named_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"

    def die() -> None:
        with Recorder(path) as recorder:
            recorder.write(results()[0])
            assert not path.exists()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        die()
    assert os.listdir(tmp_path) == ["out.mcap"]  # what came before the error is kept
    with Recorder(tmp_path / "empty.mcap"):
        pass
    assert os.listdir(tmp_path) == ["out.mcap"]


@pytest.mark.parametrize(("name", "magic"), [("OUT.BAG", b"#ROSBAG V2.0"), ("OUT.MCAP", b"\x89MCAP0")])
def test_endings_in_upper_case(tmp_path: Path, name: str, magic: bytes) -> None:
    record(tmp_path / name)
    assert os.listdir(tmp_path) == [name]
    assert (tmp_path / name).read_bytes().startswith(magic)


def test_names_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "old.mcap").touch()
    with pytest.raises(AnyNetError, match=r"old.mcap exists: expected the name of a new file$"):
        Recorder(tmp_path / "old.mcap")
    with pytest.raises(AnyNetError, match=r"cannot write .*: no folder .*none$"):
        Recorder(tmp_path / "none" / "out.mcap")
    with pytest.raises(AnyNetError, match="expected a depth encoding of 32FC1 or 16UC1, got 8UC1"):
        Recorder(tmp_path / "out.mcap", depth_encoding="8UC1")
    with pytest.raises(AnyNetError, match=r"expected a name ending in \.mp4"):
        Video(tmp_path / "out.avi", 10)
    (tmp_path / "old.mp4").touch()
    with pytest.raises(AnyNetError, match="exists"):
        Video(tmp_path / "old.mp4", 10)
    assert sorted(os.listdir(tmp_path)) == ["old.mcap", "old.mp4"]


def test_video_runs_as_time_did(tmp_path: Path) -> None:
    """Frames at 0, 0.05 and 0.1 s, at 40 per second: at pictures 0, 2 and 4."""
    path = tmp_path / "out.mp4"
    with Video(path, 40) as video:
        for result in results():
            video.write(result)
    assert os.listdir(tmp_path) == ["out.mp4"]
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FPS) == 40
    pictures = []
    while (read := capture.read())[0]:
        pictures.append(read[1])
    assert len(pictures) == 5
    assert pictures[0].shape == (16, 48, 3)  # side by side, as they are no wider than 1.5 times their height


@pytest.mark.parametrize(
    ("rate", "held"),
    [(89.9873, 89.99), (3.3e-4, 0.1), (29.97002997, 29.97), (999.96, 1000), (1e6, 1000)],
)
def test_video_at_rates_that_mpeg_4_does_not_hold(tmp_path: Path, rate: float, held: float) -> None:
    with Video(tmp_path / "out.mp4", rate) as video:
        video.write(results()[0])
        video.write(results()[0])
    capture = cv2.VideoCapture(str(tmp_path / "out.mp4"))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(held)
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 2


@contextmanager
def full_disk(size: int = 100) -> Iterator[None]:
    """Within, no file grows beyond that many bytes."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_video_on_a_full_disk(tmp_path: Path) -> None:
    video = Video(tmp_path / "out.mp4", 40)
    for result in results():
        video.write(result)
    message = r"out\.mp4: expected 5 frames, got 0 \(is the disk full\?\); what"
    with full_disk(), pytest.raises(AnyNetError, match=message):
        video.close()
    video.close()
    (part,) = os.listdir(tmp_path)
    assert part.endswith(".part.mp4")


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "folder"])
def test_recordings_on_a_full_disk(tmp_path: Path, name: str) -> None:
    """They keep the unfinished name also if there is room again, and a database keeps the frames before."""
    recorder = Recorder(tmp_path / name)
    given = results() if name == "folder" else [large() for _ in range(3)]  # bags are written by the megabyte
    for result in given:
        recorder.write(result)
    (part,) = os.listdir(tmp_path)
    inside = [path for path in (tmp_path / part, *(tmp_path / part).rglob("*")) if path.is_file()]
    with full_disk(sum(path.stat().st_size for path in inside)), pytest.raises(AnyNetError, match=r"^cannot write "):
        write_on(recorder)
    recorder.close()
    recorder.close()
    assert os.listdir(tmp_path) == [part]
    if name == "folder":
        with closing(sqlite3.connect(tmp_path / part / name / "folder.db3")) as database:
            ((count,),) = database.execute("SELECT COUNT(*) FROM messages")
        assert count == 15


def write_on(recorder: Recorder) -> None:
    for _ in range(10):
        recorder.write(large())


def large() -> Result:
    """A frame of half a megabyte."""
    left, disparity = np.zeros((400, 400, 3), np.uint8), np.ones((400, 400), np.float32)
    frame = Frame("0", left, left, STAMPS[-1], 0.0)
    return Result(frame, PreparedPair(left, left, None), Estimate(4, disparity, 1.0))


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "folder", "out.mp4"])
def test_a_second_close_does_nothing(tmp_path: Path, name: str) -> None:
    sink = Video(tmp_path / name, 40) if name == "out.mp4" else Recorder(tmp_path / name)
    with sink:
        sink.write(results()[0])
        sink.close()
    assert os.listdir(tmp_path) == [name]
    with pytest.raises(
        AnyNetError, match=f"cannot write .*{name}: expected an open file, got one that is closed or was cut off$"
    ):
        sink.write(results()[1])


def test_video_that_cannot_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anynet.streams.sinks._RATES", (0.0, 1e9))
    message = r"cannot write .*: OpenCV cannot make a video of 48 x 16 there$"
    with pytest.raises(AnyNetError, match=message), Video(tmp_path / "out.mp4", 1e-6) as video:
        video.write(results()[0])
    assert os.listdir(tmp_path) == []


def test_video_of_odd_and_wide_images(tmp_path: Path) -> None:
    left = np.full((15, 41, 3), (200, 30, 30), np.uint8)
    frame = Frame("0", left, left, 0, 0.0)
    disparity = np.full((15, 41), 5, np.float32)
    disparity[:, 20:] = np.nan
    with Video(tmp_path / "out.mp4", 10) as video:
        video.write(Result(frame, PreparedPair(left, left, None), Estimate(1, disparity, 0.0)))
    read, picture = cv2.VideoCapture(str(tmp_path / "out.mp4")).read()
    assert read
    assert picture.shape == (30, 42, 3)
    blue, green, red = picture[:14].reshape(-1, 3).mean(axis=0)  # the left image is on top, and red
    assert red > 150 > 80 > max(blue, green)


def test_millimeters() -> None:
    depth = np.array([[1.2345, np.nan, 65.535, 65.5356, 0.0004]], np.float32)
    np.testing.assert_array_equal(millimeters(depth), [[1235, 0, 65535, 0, 1]])


def test_a_recording_is_a_source_again(tmp_path: Path) -> None:
    """It has no images, and says so."""
    record(tmp_path / "out.mcap")
    with pytest.raises(AnyNetError, match="cannot tell the topics of the images"):
        Recording(tmp_path / "out.mcap")


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "folder"])
def test_a_frame_that_cannot_be_recorded_spoils_no_other(tmp_path: Path, name: str) -> None:
    first, second, *_ = results()
    wrong = replace(second, frame=replace(second.frame, stamp=2**62))
    with Recorder(tmp_path / name) as recorder:
        recorder.write(first)
        with pytest.raises(AnyNetError, match="cannot write"):
            recorder.write(wrong)
        recorder.write(second)
    assert os.listdir(tmp_path) == [name]
