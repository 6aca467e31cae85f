from __future__ import annotations

import gc
import threading
import time
from collections.abc import Iterator

import numpy as np
import psutil
import pytest
from skimage.data import stereo_motorcycle

from anynet import Predictor
from anynet.camera import Calibration, PairPreparation
from anynet.errors import AnyNetError
from anynet.streams import Frame, Stream
from anynet.trust import Trust

from .conftest import Frames, Stub, frame


def ticking(count: int, seconds: float) -> Iterator[Frame]:
    """Frames of a live source."""
    for index in range(count):
        time.sleep(seconds)
        yield frame(index)


def test_every_frame(stub: Stub) -> None:
    stream = Stream(Frames(frame(i) for i in range(50)), stub, every_frame=True)
    results = list(stream.results())
    assert [result.frame.name for result in results] == [f"{i:06}" for i in range(50)]
    assert all(result.estimate.stage == 4 for result in results)
    assert [result.estimate.disparity[0, 0] for result in results] == [4 + i for i in range(50)]
    summary = stream.statistics.summary()
    assert (summary["frames"], summary["dropped"], summary["stages"]) == (50, 0, {"4": 50})


def test_the_newest_frame_wins() -> None:
    """At 100 frames per second, and 10 ms a stage, frames are dropped; those with results are not old."""
    stream = Stream(Frames(ticking(60, 0.01), live=True), Stub(0.01))
    numbers = []
    for result in stream.results():
        time.sleep(0.03)  # the sinks are slow, too
        numbers.append(int(result.frame.name))
    assert numbers == sorted(set(numbers))
    assert numbers[-1] == 59
    assert 8 <= len(numbers) < 50
    summary = stream.statistics.summary()
    assert summary["frames"] + summary["dropped"] == 60
    assert summary["frames"] == len(numbers) == sum(summary["stages"].values())
    # Nothing queues: a frame waits for one before it, is computed, and waits for the sink once.
    assert summary["latency_ms"]["p50"] < 200
    assert 0 < summary["latency_ms"]["p50"] <= summary["latency_ms"]["p95"] <= summary["latency_ms"]["max"]
    assert 0 < summary["fps"] < 60


def test_recordings_are_played_at_their_own_pace_or_another(stub: Stub) -> None:
    def seconds(pace: float, **options: float) -> float:
        begin = time.monotonic()
        list(Stream(Frames(frame(i, time=pace * i) for i in range(5)), stub, **options).results())
        return time.monotonic() - begin

    assert seconds(0.05) >= 0.2
    assert seconds(0.0, rate=10) >= 0.4
    assert seconds(10.0, rate=100) < 20


def test_budget_and_stage_and_their_errors(stub: Stub) -> None:
    frames = [frame(i) for i in range(5)]
    assert {r.estimate.stage for r in Stream(Frames(frames), stub, stage=2, every_frame=True).results()} == {2}
    slow = Stream(Frames(frames), Stub(0.02), budget_ms=30, every_frame=True)
    assert {r.estimate.stage for r in slow.results()} <= {1, 2}
    with pytest.raises(AnyNetError, match="expected budget_ms >= 0, got -1"):
        Stream(Frames(frames), stub, budget_ms=-1)
    with pytest.raises(AnyNetError, match="expected a rate > 0, got 0"):
        Stream(Frames(frames), stub, rate=0)
    with pytest.raises(AnyNetError, match="expected a rate > 0, got '5'"):
        Stream(Frames(frames), stub, rate="5")
    with pytest.raises(AnyNetError, match="live source cannot be kept"):
        Stream(Frames(frames, live=True), stub, every_frame=True)


def test_sizes_that_change_end_it_after_the_results_before(stub: Stub) -> None:
    frames = [frame(0), frame(1), frame(2, size=(16, 25))]
    stream = Stream(Frames(frames), stub, every_frame=True)
    results = stream.results()
    assert [next(results).frame.name for _ in range(2)] == ["000000", "000001"]
    with pytest.raises(AnyNetError, match=r"^frame 000002: expected 24 x 16 as the frames before, got 25 x 16$"):
        next(results)


IMAGE = np.zeros((16, 24, 3), np.uint8)


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ((IMAGE[..., 0], IMAGE[..., 0]), "expected left as uint8 RGB array [H, W, 3], got uint8 [16, 24]"),
        ((IMAGE, IMAGE.astype(float)), "expected right as uint8 RGB array [H, W, 3], got float64 [16, 24, 3]"),
        ((None, IMAGE), "expected left as uint8 RGB array [H, W, 3], got NoneType"),
        ((IMAGE, IMAGE[:, 1:]), "expected two images of one size, got 24 x 16 and 23 x 16"),
        ((IMAGE[:0], IMAGE[:0]), "expected left as uint8 RGB array [H, W, 3], got uint8 [0, 24, 3]"),
    ],
)
def test_garbage_ends_it(stub: Stub, images: tuple[np.ndarray, np.ndarray], message: str) -> None:
    """Also as the second frame, which is looked at otherwise."""
    garbage = Frame("000001", *images, stamp=1, time=0.0)
    threads = threading.active_count()
    for frames in ([garbage], [frame(0), garbage]):
        with pytest.raises(AnyNetError) as caught:
            list(Stream(Frames(frames), stub).results())
        assert str(caught.value) == f"frame 000001: {message}"
    assert threading.active_count() == threads


def test_what_is_no_source_or_frame(stub: Stub) -> None:
    class Duck:
        live = False

    for source in ("left.png", Duck()):
        with pytest.raises(AnyNetError, match=r"expected a source of frames \(anynet.streams.Source\), got (str|Duck)"):
            Stream(source, stub)
    with pytest.raises(AnyNetError, match=r"expected the source to give frames \(anynet.streams.Frame\), got str$"):
        list(Stream(Frames(["left.png"]), stub).results())


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (1.7e9, r"it within 3600 s of the one before, got 1.7e\+09 s; with a rate \(--rate\) it does not matter$"),
        (np.inf, "its time in seconds, got inf$"),
        (np.nan, "its time in seconds, got nan$"),
        ("0", "its time in seconds, got '0'$"),
    ],
)
def test_times_that_never_come(stub: Stub, time: float, message: str) -> None:
    with pytest.raises(AnyNetError, match=f"^frame 000001: expected {message}"):
        list(Stream(Frames([frame(0), frame(1, time=time)]), stub).results())
    if time == 1.7e9:
        for options in ({"rate": 1000}, {"every_frame": True}):
            assert list(Stream(Frames([frame(0), frame(1, time=time)]), stub, **options).results())


@pytest.mark.parametrize("what", ["unpaired", "close"])
def test_a_source_that_fails_at_the_end(stub: Stub, what: str) -> None:
    def fail(*_: object) -> None:
        raise OSError("gone")

    source = type("Failing", (Frames,), {what: property(fail) if what == "unpaired" else fail})([frame(0)])
    threads = threading.active_count()
    with pytest.raises(OSError, match="gone"):
        list(Stream(source, stub, every_frame=True).results())
    assert threading.active_count() == threads


def test_results_are_asked_for_once(stub: Stub) -> None:
    stream = Stream(Frames([frame(0)]), stub, every_frame=True)
    assert len(list(stream.results())) == 1
    with pytest.raises(AnyNetError, match="expected one call of a stream's `results`, got another"):
        stream.results()
    assert stream.statistics.summary()["dropped"] == 0


def test_what_the_source_raises_reaches_the_caller(stub: Stub) -> None:
    def dying() -> Iterator[Frame]:
        yield frame(0)
        raise AnyNetError("the cable is out")

    stream = Stream(Frames(dying()), stub)
    with pytest.raises(AnyNetError, match="the cable is out"):
        list(stream.results())
    assert stream.statistics.summary()["frames"] == 1


def test_an_empty_source(stub: Stub) -> None:
    stream = Stream(Frames([]), stub)
    assert list(stream.results()) == []
    summary = stream.statistics.summary()
    assert summary == {
        "frames": 0,
        "dropped": 0,
        "unpaired": {"left": 0, "right": 0},
        "fps": 0.0,
        "latency_ms": {"p50": None, "p95": None, "max": None},
        "stages": {},
    }


def test_stop_ends_an_endless_source(stub: Stub) -> None:
    source = Frames(ticking(10**6, 0.001), live=True)
    threads = threading.active_count()
    stream = Stream(source, stub)
    for count, _ in enumerate(stream.results(), start=1):
        if count == 5:
            stream.stop()
    assert count == 5
    assert source.closed.is_set()
    assert threading.active_count() == threads


def test_leaving_the_loop_ends_the_threads(stub: Stub) -> None:
    threads = threading.active_count()
    for options in ({}, {"every_frame": True}):
        results = Stream(Frames(frame(i) for i in range(10**6)), stub, **options).results()
        next(results)
        results.close()
        assert threading.active_count() == threads


def test_unknown_disparities_and_warnings() -> None:
    """The first frame is looked at; what lies behind the cameras is not known."""
    prepare = PairPreparation(Calibration(100, 0.1, doffs=-8.0, cx=900.0))
    stream = Stream(Frames([frame(0), frame(10)]), Stub(), prepare=prepare, every_frame=True)
    first, second = stream.results()
    assert any("principal point" in warning for warning in first.warnings)
    assert second.warnings == ()
    assert np.isnan(first.estimate.disparity).all()
    assert (second.estimate.disparity == 14).all()
    assert second.pair.calibration is not None


def test_disparities_that_the_first_frame_did_not_have(stub: Stub) -> None:
    left, right, _ = stereo_motorcycle()
    pairs = (left[:, :-45], right[:, :-45]), (left[:, 45:], right[:, :-45])  # disparities 45 pixels smaller
    frames = [Frame(str(i), *map(np.ascontiguousarray, pair), stamp=i, time=0.0) for i, pair in enumerate(pairs)]
    prepare = PairPreparation(Calibration(1000, 0.2, doffs=90))
    first, second = Stream(Frames(frames), stub, prepare=prepare, every_frame=True).results()
    assert first.warnings == ()
    (warning,) = second.warnings
    assert "which are looked for from 0 on: use --min-disparity -" in warning


def test_real_predictor(weights_predictor: Predictor) -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (2, 32, 48, 3), dtype=np.uint8) for _ in range(5)]
    frames = [Frame(str(i), *pair, stamp=i, time=0.0) for i, pair in enumerate(images)]
    results = list(Stream(Frames(frames), weights_predictor, every_frame=True).results())
    for result, pair in zip(results, images, strict=True):
        expected = weights_predictor.predict(*pair).disparity
        np.testing.assert_array_equal(result.estimate.disparity, np.where(expected > 0, expected, np.nan))


def test_confidence_and_what_is_dropped_for_want_of_it(weights_predictor: Predictor) -> None:
    left, right = np.random.default_rng(0).integers(0, 256, (2, 32, 48, 3), dtype=np.uint8)
    expected = weights_predictor.predict(left, right, confidence=True)
    assert expected.confidence is not None
    least = float(np.median(expected.confidence))
    for options in ({"confidence": True}, {"trust": Trust(min_confidence=least)}):
        frames = Frames([Frame("0", left, right, stamp=0, time=0.0)])
        (result,) = Stream(frames, weights_predictor, every_frame=True, **options).results()
        np.testing.assert_array_equal(result.estimate.confidence, expected.confidence)
        np.testing.assert_array_equal(result.estimate.occluded, expected.occluded)
        known = expected.disparity > 0
        if "trust" in options:
            known &= expected.confidence >= least
        np.testing.assert_array_equal(np.isfinite(result.estimate.disparity), known)
        assert known.any()


@pytest.fixture(scope="module")
def weights_predictor() -> Predictor:
    return Predictor()


@pytest.mark.slow
def test_ten_thousand_frames_without_growth() -> None:
    stream = Stream(Frames(frame(i, (120, 160), time=0.0) for i in range(10_000)), Stub(), every_frame=True)
    process = psutil.Process()
    memory = {}
    for count, _ in enumerate(stream.results(), start=1):
        if count in (2_000, 10_000):
            gc.collect()
            memory[count] = process.memory_info().rss, len(gc.get_objects())
    assert stream.statistics.summary()["frames"] == 10_000
    assert memory[10_000][0] - memory[2_000][0] < 5e6  # one frame has 115 kB
    assert memory[10_000][1] - memory[2_000][1] < 1_000
