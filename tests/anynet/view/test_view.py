"""The page in a browser: it loads, the cloud is drawn, the slider changes the stage, the console stays quiet."""

from __future__ import annotations

import re
import shutil
import socket
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from skimage.data import stereo_motorcycle

from anynet import AnyNetError
from anynet.camera import Calibration, PairPreparation
from anynet.checkpoint import load_checkpoint
from anynet.streams import Capture, Frame
from anynet.synthetic import render

pytest.importorskip("viser", reason="the page needs viser (extra view)")
from anynet.view import Page, StillPair, View


@pytest.fixture
def view(tmp_path: Path) -> Iterator[View]:
    sample = render(3, 128, 256)
    calibration = Calibration(focal=220, baseline=0.5)
    source = StillPair("scene", sample.left, sample.right)
    view = View(source, prepare=PairPreparation(calibration, check=False), port=18080, out=tmp_path / "saved")
    thread = threading.Thread(target=view.run)
    thread.start()
    try:
        wait(lambda: view.estimate is not None)
        yield view
    finally:
        view.stop()
        thread.join(60)
        assert not thread.is_alive()


def wait(reached: Callable[[], bool], seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.05)


def shown(view: View) -> tuple[int, str]:
    assert view.estimate is not None
    return view.estimate.stage, view.page._status.content


def test_controls(view: View) -> None:
    page = view.page
    assert view.url.startswith("http://127.0.0.1:")
    assert shown(view)[0] == 4
    page._share.value = 0
    page.changed.set()
    wait(lambda: shown(view)[0] == 1)
    assert "**stage 1** of 4" in shown(view)[1]
    page._share.value = 125
    page._min_confidence.value = 1.0
    page.changed.set()
    wait(lambda: shown(view)[0] == 4 and " 0 points" in shown(view)[1])
    page._min_confidence.value = 0.0
    page._asked(page.save)
    wait(lambda: shown(view)[1].startswith("saved to"))
    names = {path.name for path in (view._out).iterdir()}
    assert {"scene_disparity.png", "scene_confidence.png", "scene_occluded.png", "scene_cloud.ply"} <= names


def test_a_save_that_fails_is_told_on_the_page(view: View) -> None:
    view._out.touch()
    view.page._asked(view.page.save)
    wait(lambda: shown(view)[1].startswith(f"**cannot make the folder {view._out}: "))
    view._out.unlink()
    view.page._asked(view.page.save)
    wait(lambda: shown(view)[1].startswith("saved to"))


@pytest.mark.parametrize(
    ("control", "value", "setting", "counts"),
    [
        ("min_confidence", float("nan"), "min_confidence", 0),
        ("min_confidence", 1.5, "min_confidence", 1),
        ("max_depth", float("nan"), "max_depth", None),
        ("max_depth", -1.0, "max_depth", None),
        ("max_depth", float("inf"), "max_depth", 1e6),
        ("share", -5, "share", 0),
        ("share", 10**9, "share", 1.25),
        ("weights", "/etc/hostname", "weights", "default"),
        ("scale", "4", "input_scale", None),
        ("scale", "x", "input_scale", None),
    ],
)
def test_what_is_not_offered(view: View, control: str, value: object, setting: str, counts: object) -> None:
    """viser passes on whatever a client sends, if it is of the control's type."""
    getattr(view.page, f"_{control}").value = value
    assert getattr(view.page.settings(), setting) == counts
    estimate = view.estimate
    wait(lambda: view.estimate is not estimate)


def test_settings_that_fail_are_told_on_the_page(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("out of\nmemory")

    with monkeypatch.context() as patch:
        patch.setattr(view, "_loaded", fail)
        view.page._scale.value = "2"
        wait(lambda: shown(view)[1] == "**out of memory**")
    view.page._scale.value = "0.5"
    wait(lambda: shown(view)[1].startswith("**stage "))


def test_a_stop_while_a_camera_is_opened_again() -> None:
    lost, reopened = threading.Event(), threading.Event()

    class Camera:
        def __init__(self, name: str) -> None:
            if lost.is_set():
                reopened.set()

        def isOpened(self) -> bool:
            return not lost.is_set()

        def retrieve(self) -> tuple[bool, np.ndarray]:
            return True, np.zeros((48, 128, 3), np.uint8)

        def get(self, key: int) -> float:
            return 30.0

        def set(self, key: int, value: float) -> bool:
            return True

        def release(self) -> None:
            pass

        grab = isOpened

    view = View(Capture(["0"], live=True, reconnect=60, open=Camera), prepare=PairPreparation(check=False), port=18110)
    thread = threading.Thread(target=view.run, daemon=True)
    thread.start()
    wait(lambda: view.estimate is not None)
    lost.set()
    assert reopened.wait(60)
    view.stop()
    thread.join(30)
    assert not thread.is_alive()


def test_a_source_that_fails_because_it_was_closed() -> None:
    class Lines(StillPair):
        live = True

        def frames(self) -> Iterator[Frame]:
            yield from super().frames()
            begun.set()
            closed.wait(10)
            raise ValueError("read of closed file")

        def close(self) -> None:
            closed.set()

    begun, closed = threading.Event(), threading.Event()
    view = View(Lines("scene", *np.zeros((2, 48, 64, 3), np.uint8)), prepare=PairPreparation(check=False), port=18113)
    threading.Thread(target=lambda: begun.wait(10) and view.stop()).start()
    view.run()
    assert closed.is_set()


def test_a_stop_before_the_first_frame() -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    view = View(StillPair("scene", image, image), prepare=PairPreparation(check=False), port=18111)
    view.stop()
    view.run()
    assert view.estimate is None


@pytest.mark.parametrize(
    ("source", "rate"), [("left.png", None), (StillPair("", *np.zeros((2, 8, 8, 3), np.uint8)), 0)]
)
def test_what_is_no_source_or_rate(source: object, rate: float | None) -> None:
    with pytest.raises(AnyNetError, match=r"expected a (source of frames|rate > 0)"):
        View(source, rate=rate)


@pytest.mark.slow
def test_in_a_browser(view: View, tmp_path: Path) -> None:
    selenium = pytest.importorskip("selenium", reason="the browser test needs selenium")
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        pytest.skip("the browser test needs chromium and chromium-driver")
    from selenium import webdriver
    from selenium.common.exceptions import TimeoutException
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    assert selenium
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for argument in (
        "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader", "--window-size=1100,700",
    ):  # fmt: skip
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.ChromeService(str(shutil.which("chromedriver")))
    driver = webdriver.Chrome(options=options, service=service)
    try:
        driver.set_page_load_timeout(180)
        driver.get(view.url)
        wait(lambda: "stage 4" in driver.find_element(By.TAG_NAME, "body").text, 180)
        picture = tmp_path / "page.png"

        def cloud() -> float:
            """Share of the page's middle that is not background, white."""
            try:
                driver.save_screenshot(str(picture))
            except TimeoutException:  # a busy machine that draws without a GPU
                return 0.0
            image = cv2.imread(str(picture))
            assert image is not None
            height, width = image.shape[:2]
            middle = image[height // 3 : height * 2 // 3, width * 2 // 5 : width * 3 // 5].astype(int)
            return float((np.abs(middle - 255).max(2) > 24).mean())

        wait(lambda: cloud() > 0.3, 180)
        slider = driver.find_elements(By.CSS_SELECTOR, "[role=slider]")[0]
        slider.send_keys(Keys.HOME)
        wait(lambda: shown(view)[0] == 1)
        wait(lambda: "stage 1" in driver.find_element(By.TAG_NAME, "body").text)
        slider.send_keys(Keys.END)
        wait(lambda: "stage 4" in driver.find_element(By.TAG_NAME, "body").text)
        assert cloud() > 0.3
        errors = [entry for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]
        assert not errors
    finally:
        driver.quit()


def test_videos_begin_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And what is wrong with them is told once."""
    writer = cv2.VideoWriter(str(tmp_path / "both.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (128, 48))
    for level in range(3):
        writer.write(np.full((48, 128, 3), 50 * level, np.uint8))
    writer.release()
    source = Capture([str(tmp_path / "both.avi")], live=False)
    view = View(source, prepare=PairPreparation(Calibration(100, 0.1, cx=900.0)), port=18095)
    try:
        names = [frame.name for frame, _ in islice(view._frames(), 7)]
    finally:
        view.page.close()
    assert names == ["000000", "000001", "000002"] * 2 + ["000000"]
    assert capsys.readouterr().err.count("principal point") == 1


def test_what_the_first_frame_did_not_have_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """As by streams: disparities below those that are looked for."""
    left, right, _ = stereo_motorcycle()
    pairs = (left[:, :-45], right[:, :-45]), (left[:, 45:], right[:, :-45])  # disparities 45 pixels smaller
    frames = [Frame(name, *pair, 0, 0.0) for name, pair in zip("ab", pairs, strict=True)]

    class Two(StillPair):
        def frames(self) -> Iterator[Frame]:
            return iter(frames)

    source = Two("", left, right)
    for watch, told in ((True, 1), (False, 0)):
        view = View(source, prepare=PairPreparation(Calibration(1000, 0.2, doffs=90)), port=18098, watch=watch)
        try:
            assert [frame.name for frame, _ in islice(view._frames(), 4)] == ["a", "b", "a", "b"]
        finally:
            view.page.close()
        assert capsys.readouterr().err.count("anynet: b: warning: matched corners have disparities down to -") == told


def test_weights_are_loaded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """And mistakes in them are told before the page is up."""
    loads: list[object] = []
    monkeypatch.setattr("anynet.predictor.load_checkpoint", lambda *a: loads.append(a) or load_checkpoint(*a))
    source = StillPair("scene", *np.zeros((2, 64, 64, 3), np.uint8))
    other = View(source, prepare=PairPreparation(check=False), port=18099)
    other._show(*next(other._frames()))
    other.page.close()
    assert loads == [("default", None)]
    monkeypatch.setattr("anynet.view.view.Page", None)
    with pytest.raises(AnyNetError, match="expected a file of weights"):
        View(source, weights=["none"])


def test_a_source_without_frames() -> None:
    class Empty(StillPair):
        def frames(self) -> Iterator[object]:  # type: ignore[override]
            return iter(())

    image = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(AnyNetError, match="the source has no frames"):
        View(Empty("", image, image), port=18090).run()


def test_a_host_of_ip_version_6() -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")
    page = Page("::1", 18100, ["default"])
    try:
        assert re.fullmatch(r"http://\[::1\]:\d+", page.url)
        with urllib.request.urlopen(page.url, timeout=60) as answer:
            assert answer.status == 200
    finally:
        page.close()


@pytest.mark.parametrize("host", ["no such host", "a" * 300, "256.1.1.1"])
def test_a_host_that_nothing_can_listen_on(host: str, tmp_path: Path) -> None:
    source = StillPair("scene", *np.zeros((2, 64, 64, 3), np.uint8))
    with pytest.raises(AnyNetError, match=f"cannot listen on the host {host}: "):
        View(source, prepare=PairPreparation(check=False), host=host, out=tmp_path)
