from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from anynet.errors import AnyNetError
from anynet.streams import Capture, Frame


class FakeCamera:
    """A camera whose images count up; gone while `plugged` is not set."""

    plugged = threading.Event()
    opened = 0

    def __init__(self, name: str, images: list[np.ndarray | None] | None = None) -> None:
        type(self).opened += 1
        self.count = 0
        self.asked: dict[int, float] = {}
        self.released = False
        self.images = images

    def isOpened(self) -> bool:
        return self.plugged.is_set() and not self.released

    def grab(self) -> bool:
        self.count += 1
        return self.plugged.is_set() and not self.released

    def retrieve(self) -> tuple[bool, np.ndarray | None]:
        if self.images is not None:
            image = self.images[min(self.count, len(self.images)) - 1]
            return image is not None, image
        return True, np.full((8, 12, 3), (0, 0, self.count), np.uint8)  # BGR

    def get(self, key: int) -> float:
        return {cv2.CAP_PROP_FPS: 25.0}.get(key, 0.0)

    def set(self, key: int, value: float) -> bool:
        self.asked[key] = value
        return True

    def release(self) -> None:
        self.released = True


@pytest.fixture
def plugged() -> Iterator[threading.Event]:
    FakeCamera.plugged.set()
    FakeCamera.opened = 0
    yield FakeCamera.plugged
    FakeCamera.plugged.clear()


def test_two_cameras(plugged: threading.Event) -> None:
    devices: list[FakeCamera] = []

    def open_(name: str) -> FakeCamera:
        devices.append(FakeCamera(name))
        return devices[-1]

    source = Capture(["0", "2"], live=True, rate=15, size=(640, 480), open=open_)
    assert source.rate == 15
    frames = source.frames()
    first, second = next(frames), next(frames)
    assert (first.left == (1, 0, 0)).all()  # RGB
    assert (second.right == (2, 0, 0)).all()
    assert [first.name, second.name] == ["000000", "000001"]
    assert abs(first.stamp - time.time_ns()) < 10e9
    assert second.stamp > first.stamp
    for device in devices:
        asked = {cv2.CAP_PROP_FRAME_WIDTH: 640, cv2.CAP_PROP_FRAME_HEIGHT: 480, cv2.CAP_PROP_FPS: 15}
        assert asked.items() <= device.asked.items()
    source.close()
    assert list(frames) == []
    assert all(device.released for device in devices)


def test_one_side_by_side(plugged: threading.Event) -> None:
    source = Capture(["0"], live=True, open=FakeCamera)
    frame = next(source.frames())
    assert frame.left.shape == frame.right.shape == (8, 6, 3)
    assert source.rate == 25


def test_a_camera_that_comes_back(plugged: threading.Event) -> None:
    source = Capture(["0"], live=True, reconnect=20, open=FakeCamera)
    frames = source.frames()
    next(frames)
    plugged.clear()
    threading.Timer(0.7, plugged.set).start()
    frame = next(frames)
    assert frame.name == "000001"
    assert FakeCamera.opened >= 3  # tried in vain at least once


def test_a_camera_that_stays_away_or_is_closed_meanwhile(plugged: threading.Event) -> None:
    frames = Capture(["0"], live=True, reconnect=0.6, open=FakeCamera).frames()
    next(frames)
    plugged.clear()
    with pytest.raises(AnyNetError, match=r"^0: no image any more, and none for 0\.6 s of trying again$"):
        next(frames)
    plugged.set()
    source = Capture(["0"], live=True, reconnect=600, open=FakeCamera)
    frames = source.frames()
    next(frames)
    plugged.clear()
    threading.Timer(0.2, source.close).start()
    assert list(frames) == []


def test_cameras_that_lie(plugged: threading.Event) -> None:
    def of(*images: np.ndarray | None) -> Capture:
        return Capture(["0"], live=True, reconnect=0.1, open=lambda name: FakeCamera(name, list(images)))

    with pytest.raises(AnyNetError, match="expected images of 8 bits, got uint16"):
        next(of(np.zeros((8, 12, 3), np.uint16)).frames())
    with pytest.raises(AnyNetError, match="even width, got 13"):
        next(of(np.zeros((8, 13, 3), np.uint8)).frames())
    with pytest.raises(AnyNetError, match="no image any more"):
        next(of(None).frames())
    assert (next(of(np.full((8, 12), 7, np.uint8)).frames()).left == 7).all()
    sizes = iter([(8, 12), (8, 10)])
    two = Capture(["a", "b"], live=True, open=lambda name: FakeCamera(name, [np.zeros((*next(sizes), 3), np.uint8)]))
    with pytest.raises(AnyNetError, match=r"^a and b: expected two images of one size, got 12 x 8 and 10 x 8$"):
        next(two.frames())


def test_what_cannot_be_opened(tmp_path: Path) -> None:
    (tmp_path / "garbage.mp4").write_bytes(b"garbage" * 100)
    for name in (str(tmp_path / "none.mp4"), str(tmp_path / "garbage.mp4"), "77"):
        with pytest.raises(AnyNetError, match=f"^cannot open {name}: no such "):
            Capture([name], live=name == "77")


@pytest.mark.parametrize("names", [[], ["0", "1", "2"], "10"])
def test_names_that_are_not_one_or_two(names: list[str]) -> None:
    with pytest.raises(AnyNetError, match=r"^expected the names of one or two cameras or videos, got "):
        Capture(names, live=True, open=FakeCamera)
    with pytest.raises(AnyNetError, match=r"^expected a rate > 0, got nan"):
        Capture(["0"], live=True, rate=float("nan"), open=FakeCamera)


def video(path: Path, count: int, width: int = 64, rate: float = 20) -> Path:
    """Images of gray levels about 20, 30, ..."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate, (width, 48))
    for index in range(count):
        noise = np.random.default_rng(index).integers(-5, 6, (48, width, 1)).repeat(3, axis=2)
        writer.write((20 + 10 * index + noise).clip(0, 255).astype(np.uint8))
    writer.release()
    return path


def test_videos(tmp_path: Path) -> None:
    paths = [video(tmp_path / f"{name}.avi", 6) for name in "ab"]
    with Capture([str(path) for path in paths], live=False) as source:
        assert source.rate == 20
        assert source.warnings == []
        frames = list(source.frames())
    assert [frame.left.mean() for frame in frames] == pytest.approx([20, 30, 40, 50, 60, 70], abs=2)
    assert [frame.time for frame in frames] == pytest.approx([0, 0.05, 0.1, 0.15, 0.2, 0.25])
    assert frames[3].stamp - frames[0].stamp == 150_000_000
    (both,) = Capture([str(video(tmp_path / "c.avi", 1))], live=False, rate=5).frames()
    assert both.left.shape == (48, 32, 3)
    uneven = Capture([str(paths[0]), str(video(tmp_path / "d.avi", 4))], live=False)
    assert uneven.warnings == [f"{paths[0]} and {tmp_path / 'd.avi'} have 6 and 4 frames"]
    assert len(list(uneven.frames())) == 4


def test_videos_begin_again(tmp_path: Path) -> None:
    """After their end, and after a reader that left before it; not once they are closed."""
    names = [str(video(tmp_path / f"{name}.avi", 4)) for name in "ab"]
    with Capture(names, live=False) as source:
        next(source.frames())
        for _ in range(2):
            assert [frame.left.mean() for frame in source.frames()] == pytest.approx([20, 30, 40, 50], abs=2)
        Path(names[1]).unlink()
        with pytest.raises(AnyNetError, match=rf"^cannot open {names[1]}: no such video"):
            next(source.frames())
    assert list(source.frames()) == []


def test_rates_that_differ_are_told(tmp_path: Path) -> None:
    names = [str(video(tmp_path / f"{rate}.avi", 2, rate=rate)) for rate in (30, 29.97, 15)]
    assert Capture(names[:2], live=False).warnings == []
    (warning,) = Capture(names[1:], live=False).warnings
    assert warning.endswith("have 29.97 and 15 frames per second, and are paired frame by frame")


def test_a_video_cut_off_ends_in_one_line(tmp_path: Path) -> None:
    """After its frames; the shorter of two counts."""
    cut, whole = (video(tmp_path / f"{name}.avi", 20) for name in ("cut", "whole"))
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size * 3 // 4])
    for names in ([cut], [cut, whole], [whole, cut]):
        frames: list[Frame] = []
        with pytest.raises(AnyNetError, match=r"avi: expected 20 frames, got 1\d: damaged or cut off there$"):
            frames.extend(Capture(list(map(str, names)), live=False).frames())
        assert 10 <= len(frames) < 20
    assert len(list(Capture([str(cut), str(video(tmp_path / "short.avi", 5))], live=False).frames())) == 5


@pytest.mark.parametrize(("name", "count"), [("a.mp4", 4), ("a.mp4", 0), ("a.mp4", -1), ("a.ts", 99)])
def test_a_number_of_frames_that_is_not_known_or_one_too_many(
    plugged: threading.Event, name: str, count: float
) -> None:
    class File(FakeCamera):
        def get(self, key: int) -> float:
            return count if key == cv2.CAP_PROP_FRAME_COUNT else super().get(key)

    image = np.zeros((8, 12, 3), np.uint8)
    source = Capture([name], live=False, open=lambda name: File(name, [image, image, image, None]))
    assert len(list(source.frames())) == 3


class Mjpeg(BaseHTTPRequestHandler):
    """Five images on each connection, then it breaks."""

    connections = 0

    def do_GET(self) -> None:
        type(self).connections += 1
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
        self.end_headers()
        jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), 50 * self.connections, np.uint8))[1].tobytes()
        for _ in range(5):
            self.wfile.write(
                b"--next\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg) + jpeg + b"\r\n"
            )

    def log_message(self, *_: object) -> None:
        pass


def test_a_network_stream_is_opened_again() -> None:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Mjpeg)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        source = Capture([f"http://127.0.0.1:{server.server_port}/camera.mjpg"], live=True, reconnect=30)
        levels = []
        for frame in source.frames():
            levels.append(round(float(frame.left.mean()) / 50))
            if levels[-1] >= 3:
                source.close()
        assert levels == sorted(levels)
        assert {1, 3} <= set(levels)
    finally:
        server.shutdown()
        server.server_close()
    assert Mjpeg.connections >= 2
