from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections import Counter
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from processes import completed

from anynet import AnyNet, Estimate, Predictor, Worker, save_checkpoint
from anynet.errors import AnyNetError
from anynet.worker import Latest

IMAGE = np.zeros((8, 8, 3), np.uint8)


class Stepper:
    """A predictor that computes a stage when it is told to. The first pixel of the left image names the frame."""

    def __init__(self) -> None:
        self.steps = threading.Semaphore(0)
        self.begun: list[int] = []

    def stages(self, left: np.ndarray, right: np.ndarray) -> Iterator[Estimate]:
        self.begun.append(int(left[0, 0, 0]))
        for stage in range(1, 5):
            assert self.steps.acquire(timeout=10)
            if left[0, 0, 0] == 13:
                raise ZeroDivisionError("frame 13")
            yield Estimate(stage, np.full((8, 8), float(left[0, 0, 0]), np.float32), 1.0)

    def step(self, count: int = 1) -> None:
        self.steps.release(count)


def image(value: int) -> np.ndarray:
    return np.full((8, 8, 3), value, np.uint8)


def wait_for(condition: object) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline, "waited 10 s"
        time.sleep(0.001)


@pytest.fixture
def stepper() -> Stepper:
    return Stepper()


@pytest.fixture
def worker(stepper: Stepper) -> Iterator[Worker]:
    worker = Worker(stepper)
    yield worker
    stepper.step(1000)
    worker.close()


def at(worker: Worker) -> tuple[int, int] | None:
    latest = worker.latest()
    return None if latest is None else (latest.frame, latest.stage)


def test_estimates_arrive_one_by_one(worker: Worker, stepper: Stepper) -> None:
    assert worker.latest() is None
    assert worker.submit(image(7), IMAGE, stamp="noon") == 1
    for stage in range(1, 5):
        stepper.step()
        wait_for(lambda stage=stage: at(worker) == (1, stage))
    latest = worker.latest()
    assert isinstance(latest, Latest)
    assert latest.stamp == "noon"
    assert latest.disparity[0, 0] == 7
    time.sleep(0.01)
    assert worker.latest().age_ms >= latest.age_ms + 10


def test_a_frame_replaces_one_not_begun(worker: Worker, stepper: Stepper) -> None:
    worker.submit(image(1), IMAGE)
    wait_for(lambda: stepper.begun == [1])
    for value in (2, 3, 4):
        worker.submit(image(value), IMAGE)
    stepper.step(8)
    wait_for(lambda: at(worker) == (4, 4))
    assert stepper.begun == [1, 4]


def test_submitted_images_may_be_overwritten(worker: Worker, stepper: Stepper) -> None:
    worker.submit(image(1), IMAGE)
    camera = image(2)
    worker.submit(camera, IMAGE)
    camera[:] = 99
    stepper.step(8)
    wait_for(lambda: at(worker) is not None and at(worker)[1] == 4 and stepper.begun[-1] != 1)
    assert stepper.begun[-1] == 2


def test_cancel_keeps_the_estimates_so_far(worker: Worker, stepper: Stepper) -> None:
    worker.submit(image(1), IMAGE)
    stepper.step()
    wait_for(lambda: at(worker) == (1, 1))
    worker.submit(image(2), IMAGE)
    worker.cancel()
    stepper.step()  # the stage that was running
    worker.submit(image(3), IMAGE)
    wait_for(lambda: stepper.begun == [1, 3])
    assert at(worker) == (1, 1)


def test_an_exception_reaches_the_caller_once(worker: Worker, stepper: Stepper) -> None:
    worker.submit(image(13), IMAGE)
    stepper.step()
    with pytest.raises(ZeroDivisionError, match="frame 13"):
        wait_for(worker.latest)
    assert worker.latest() is None
    worker.submit(image(1), IMAGE)
    stepper.step(4)
    wait_for(lambda: at(worker) == (2, 4))


def test_wrong_images_are_refused_at_once(worker: Worker) -> None:
    with pytest.raises(AnyNetError, match="expected right as uint8"):
        worker.submit(IMAGE, IMAGE[..., 0])


def test_close_ends_the_thread_and_is_final(stepper: Stepper) -> None:
    before = threading.active_count()
    with Worker(stepper) as worker:
        worker.submit(image(1), IMAGE)
        stepper.step(2)
        wait_for(lambda: at(worker) == (1, 2))
        stepper.step()
    assert threading.active_count() == before
    assert at(worker) == (1, 2)
    worker.close()
    with pytest.raises(AnyNetError, match="submit after close"):
        worker.submit(IMAGE, IMAGE)


def test_nothing_blocks_while_a_stage_is_computed(worker: Worker, stepper: Stepper) -> None:
    worker.submit(image(1), IMAGE)
    wait_for(lambda: stepper.begun == [1])  # and now it waits for its step
    start = time.monotonic()
    for _ in range(100):
        worker.submit(image(2), IMAGE)
        worker.latest()
        worker.cancel()
    assert time.monotonic() - start < 2


def test_a_newer_frame_takes_over_after_the_first_estimate(worker: Worker, stepper: Stepper) -> None:
    worker.submit(image(1), IMAGE)
    wait_for(lambda: stepper.begun == [1])
    worker.submit(image(2), IMAGE)
    stepper.step()
    wait_for(lambda: stepper.begun == [1, 2])
    assert at(worker) == (1, 1)
    stepper.step(2)
    wait_for(lambda: at(worker) == (2, 2))
    worker.submit(image(3), IMAGE)
    stepper.step()  # the stage that was running
    wait_for(lambda: stepper.begun == [1, 2, 3])
    assert at(worker) == (2, 3)


def test_without_preemption_the_running_frame_is_finished(stepper: Stepper) -> None:
    with Worker(stepper, preempt=False) as worker:
        worker.submit(image(1), IMAGE)
        wait_for(lambda: stepper.begun == [1])
        worker.submit(image(2), IMAGE)
        stepper.step(4)
        wait_for(lambda: stepper.begun == [1, 2])
        assert at(worker) == (1, 4)
        stepper.step(4)
        wait_for(lambda: at(worker) == (2, 4))


class Slow:
    """A predictor whose stages take a fixed time each."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.computed = 0

    def stages(self, left: np.ndarray, right: np.ndarray) -> Iterator[Estimate]:
        for stage in range(1, 5):
            time.sleep(self.seconds)
            self.computed += 1
            yield Estimate(stage, np.zeros(left.shape[:2], np.float32), 1e3 * stage * self.seconds)


@pytest.mark.parametrize("cancel", [False, True])
@pytest.mark.parametrize("share", [0.6, 1.7])
def test_a_slow_network_keeps_up_with_the_newest_frame(cancel: bool, share: float) -> None:
    """Frames come faster than all stages, or even the first, are computed; none may starve the others."""
    period = 0.02
    seen: dict[int, float] = {}
    with Worker(Slow(share * period)) as worker:
        for _ in range(30):
            if cancel:
                worker.cancel()
            worker.submit(IMAGE, IMAGE)
            end = time.monotonic() + period
            while time.monotonic() < end:
                latest = worker.latest()
                if latest is not None:
                    seen.setdefault(latest.frame, latest.age_ms)
                time.sleep(0.001)
    # All but the first and last, or as many as the first stage allows; a busy machine loses some.
    assert len(seen) >= 0.7 * 30 / max(1, share)
    assert np.median(list(seen.values())) < 1e3 * (2 * share + 1) * period


def test_the_last_stage(stepper: Stepper) -> None:
    with Worker(stepper, stage=2) as worker:
        worker.submit(image(1), IMAGE)
        stepper.step(2)
        latest = worker.result(10)
        assert latest is not None
        assert (latest.frame, latest.stage) == (1, 2)
        worker.submit(image(2), IMAGE)
        wait_for(lambda: stepper.begun == [1, 2])
        stepper.step(2)


def test_a_budget_ends_frames_in_time() -> None:
    predictor = Slow(0.02)
    with Worker(predictor, budget_ms=50) as worker:
        for number in range(1, 6):
            worker.submit(IMAGE, IMAGE)
            latest = worker.result(10)
            assert latest is not None
            assert latest.frame == number
            assert 1 <= latest.stage <= 2
        assert latest.stage == 2 or predictor.computed < 10  # a busy machine may do less, never more
    with Worker(predictor, budget_ms=0) as worker:
        worker.submit(IMAGE, IMAGE)
        latest = worker.result(10)
        assert latest is not None
        assert latest.stage == 1


@pytest.mark.parametrize("asked", [{}, {"confidence": True}, {"confidence": True, "left_right": True}])
def test_confidence_is_the_predictors(predictor: Predictor, asked: dict[str, bool]) -> None:
    left, right = np.random.default_rng(0).integers(0, 256, (2, 32, 48, 3), dtype=np.uint8)
    with Worker(predictor, **asked) as worker:
        worker.submit(left, right)
        latest = worker.result(60)
    assert latest is not None
    expected = predictor.predict(left, right, **asked)
    assert (latest.confidence is None) == (latest.occluded is None) == (not asked)
    if asked:
        np.testing.assert_array_equal(latest.confidence, expected.confidence)
        np.testing.assert_array_equal(latest.occluded, expected.occluded)


def test_result_gives_each_frame_once(worker: Worker, stepper: Stepper) -> None:
    assert worker.result(Fraction(1, 100)) is None
    stepper.step(4)
    worker.submit(image(7), IMAGE, stamp="noon")
    latest = worker.result(10)
    assert latest is not None
    assert (latest.frame, latest.stage, latest.stamp) == (1, 4, "noon")
    assert worker.result(0.01) is None
    stepper.step()
    worker.submit(image(13), IMAGE)
    with pytest.raises(ZeroDivisionError):
        worker.result(10)
    assert worker.result(0.01) is None
    waiting = threading.Timer(0.05, worker.close)
    waiting.start()
    assert worker.result() is None
    waiting.join()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"budget_ms": "5"}, "expected budget_ms >= 0, got '5'"),
        ({"budget_ms": True}, "expected budget_ms >= 0, got True"),
        ({"budget_ms": float("nan")}, "expected budget_ms >= 0, got nan"),
        ({"budget_ms": -1}, "expected budget_ms >= 0, got -1"),
        ({"stage": 2.5}, "expected stage from 1 to 4, got 2.5"),
        ({"stage": True}, "expected stage from 1 to 4, got True"),
        ({"stage": "2"}, "expected stage from 1 to 4, got '2'"),
        ({"stage": 0}, "expected stage from 1 to 4, got 0"),
        ({"stage": 5}, "expected stage from 1 to 4, got 5"),
        ({"preempt": "no"}, "expected preempt as True or False, got 'no'"),
        ({"confidence": 1}, "expected confidence as True or False, got 1"),
        ({"confidence": True, "left_right": None}, "expected left_right as True or False, got None"),
        ({"left_right": True}, "expected left_right together with confidence"),
    ],
)
def test_options_that_cannot_be(predictor: Predictor, options: dict[str, object], message: str) -> None:
    with pytest.raises(AnyNetError, match=re.escape(message)):
        Worker(predictor, **options)


@pytest.mark.parametrize("predictor", [None, "default"])
def test_what_is_no_predictor(predictor: object) -> None:
    with pytest.raises(AnyNetError, match=f"Worker: expected a predictor, got {predictor!r}"):
        Worker(predictor)  # type: ignore[arg-type]


@pytest.mark.parametrize("timeout", ["5", True, float("nan")])
def test_a_timeout_that_cannot_be(worker: Worker, timeout: object) -> None:
    with pytest.raises(AnyNetError, match=f"expected timeout in seconds, got {timeout!r}"):
        worker.result(timeout)


def test_times_beyond_any_clock(predictor: Predictor) -> None:
    image = np.zeros((16, 16, 3), np.uint8)
    with Worker(predictor, budget_ms=10**400) as worker:
        worker.submit(image, image)
        assert worker.result(timeout=10**400).stage == 4
        assert worker.result(timeout=-(10**400)) is None


def test_a_thread_that_cannot_start(worker: Worker, stepper: Stepper, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", fail)
        for _ in range(2):
            with pytest.raises(AnyNetError, match="cannot start its thread: can't start new thread"):
                worker.submit(image(1), IMAGE)
        worker.close()  # nothing to wait for
    with Worker(stepper) as other:
        with monkeypatch.context() as patch:
            patch.setattr(threading.Thread, "start", fail)
            with pytest.raises(AnyNetError):
                other.submit(image(1), IMAGE)
        assert other.submit(image(2), IMAGE) == 1  # the next one tries again
        stepper.step(4)
        wait_for(lambda: at(other) == (1, 4))


def test_a_frame_that_ends_its_thread_does_not_end_the_worker(worker: Worker, stepper: Stepper) -> None:
    class Exit:
        def stages(self, left: np.ndarray, right: np.ndarray) -> Iterator[Estimate]:
            if left[0, 0, 0]:
                raise SystemExit("out of the predictor")
            yield Estimate(1, np.zeros((8, 8), np.float32), 1.0)

    with Worker(Exit()) as worker:
        worker.submit(image(1), IMAGE)
        with pytest.raises(SystemExit):
            worker.result(10)
        worker.submit(image(0), IMAGE)
        wait_for(lambda: at(worker) == (2, 1))


def test_a_worker_dropped_without_close_ends_its_thread(stepper: Stepper) -> None:
    def threads() -> int:
        return sum(thread.name == "anynet-worker" for thread in threading.enumerate())

    before = threads()
    stepper.step(1000)
    for _ in range(20):
        worker = Worker(stepper)
        worker.submit(image(1), IMAGE)
        assert worker.result(10) is not None
    assert threads() > before
    del worker
    wait_for(lambda: threads() == before)


def test_frames_are_forgotten(stepper: Stepper) -> None:
    """Neither the thread that waits nor the newest estimate keeps a frame's images."""
    copies: list[weakref.ref[np.ndarray]] = []

    class Watch(Stepper):
        def stages(self, left: np.ndarray, right: np.ndarray) -> Iterator[Estimate]:
            copies.extend([weakref.ref(left), weakref.ref(right)])
            yield Estimate(1, np.zeros((8, 8), np.float32), 1.0)

    with Worker(Watch()) as worker:
        worker.submit(IMAGE, IMAGE)
        assert worker.result(10) is not None
        wait_for(lambda: len(copies) == 2 and all(copy() is None for copy in copies))


@pytest.fixture(scope="module")
def predictor(tmp_path_factory: pytest.TempPathFactory) -> Predictor:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    save_checkpoint(path, AnyNet())
    return Predictor(path)


def test_many_threads_under_load(predictor: Predictor) -> None:
    """Frames and stages never go backwards for anybody, and every estimate belongs to its frame."""
    frames = [np.random.default_rng(i).integers(0, 256, (2, 32, 48, 3), dtype=np.uint8) for i in range(4)]
    truth = [[e.disparity for e in predictor.stages(*frame)] for frame in frames]
    done = threading.Event()
    problems: list[str] = []
    polls = [0] * 8

    def poll(who: int) -> None:
        newest = (0, 0)
        while not done.is_set():
            latest = worker.latest()
            if latest is not None:
                if (latest.frame, latest.stage) < newest:
                    problems.append(f"{newest} then {(latest.frame, latest.stage)}")
                if not np.allclose(latest.disparity, truth[latest.stamp][latest.stage - 1], atol=1e-3):
                    problems.append(f"frame {latest.frame}, stage {latest.stage}: not its disparity")
                newest = (latest.frame, latest.stage)
                polls[who] += 1
            time.sleep(0.0005)

    with Worker(predictor) as worker:
        pollers = [threading.Thread(target=poll, args=(i,)) for i in range(len(polls))]
        for thread in pollers:
            thread.start()
        for i in range(60):
            last = worker.submit(*frames[i % 4], stamp=i % 4)
            time.sleep(0.005)
        wait_for(lambda: at(worker) == (last, 4))
        done.set()
        for thread in pollers:
            thread.join()
    assert problems == []
    assert min(polls) > 0


@pytest.mark.slow
@pytest.mark.timeout(0)
def test_sixteen_threads_on_two_workers(predictor: Predictor) -> None:
    """Whatever meets whatever, every estimate is, bit for bit, that of its frame computed alone.

    ANYNET_STRESS_SECONDS says for how long (default 20).
    """
    end = time.monotonic() + float(os.environ.get("ANYNET_STRESS_SECONDS", "20"))
    frames = [np.random.default_rng(i).integers(0, 256, (2, 32 + 16 * i, 48, 3), dtype=np.uint8) for i in range(4)]
    truth = [[e.disparity for e in predictor.stages(*frame)] for frame in frames]
    problems: list[str] = []
    counts: Counter[str] = Counter()

    def check(what: str, stage: int, frame: int, disparity: np.ndarray) -> None:
        counts[what] += 1
        if not np.array_equal(disparity, truth[frame][stage - 1]):
            problems.append(f"{what}: stage {stage} of frame {frame} differs")

    def act(seed: int) -> None:
        random = np.random.default_rng(seed)
        try:
            while time.monotonic() < end and not problems:
                worker, frame = workers[random.integers(2)], int(random.integers(4))
                match random.integers(8):
                    case 0:
                        estimate = predictor.predict(*frames[frame], stage=int(random.integers(1, 5)))
                        check("predict", estimate.stage, frame, estimate.disparity)
                    case 1:
                        worker.cancel()
                    case 2 | 3:
                        worker.submit(*frames[frame], stamp=frame)
                        counts["submit"] += 1
                    case 4:
                        if (latest := worker.result(0.01)) is not None:
                            check("result", latest.stage, latest.stamp, latest.disparity)
                    case _:
                        if (latest := worker.latest()) is not None:
                            check("latest", latest.stage, latest.stamp, latest.disparity)
        except Exception as error:
            problems.append(repr(error))

    with Worker(predictor) as first, Worker(predictor, budget_ms=5, preempt=False) as second:
        workers = first, second
        threads = [threading.Thread(target=act, args=(seed,)) for seed in range(16)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert problems == []
    assert min(counts[what] for what in ("predict", "submit", "result", "latest")) > 20
    print(dict(counts))


def test_a_forked_child_starts_afresh(predictor: Predictor) -> None:
    with Worker(predictor) as worker:
        worker.submit(IMAGE, IMAGE)
        wait_for(lambda: at(worker) == (1, 4))
        child = os.fork()
        if child == 0:
            signal.alarm(20)
            afresh = worker.latest() is None
            number = worker.submit(IMAGE, IMAGE)
            wait_for(lambda: at(worker) == (number, 4))
            worker.close()
            os._exit(0 if afresh else 1)
        assert os.waitpid(child, 0)[1] == 0
        assert at(worker) == (1, 4)


def test_a_program_that_forgets_to_close_still_ends(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "random.safetensors", AnyNet())
    program = f"""
import numpy, anynet
worker = anynet.Worker(anynet.Predictor({str(tmp_path / "random.safetensors")!r}))
image = numpy.zeros((64, 64, 3), numpy.uint8)
worker.submit(image, image)
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_a_worker_busy_at_exit(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "random.safetensors", AnyNet())
    program = f"""
import numpy, anynet
worker = anynet.Worker(anynet.Predictor({str(tmp_path / "random.safetensors")!r}))
image = numpy.zeros((400, 600, 3), numpy.uint8)
for _ in range(20):
    worker.submit(image, image)
    worker.result(0.01)
"""
    ends = "pass", "raise SystemExit(0)", "worker.submit(image, image)"
    for result in completed([[sys.executable, "-c", program + end] for end in ends]):
        assert (result.returncode, result.stderr) == (0, "")
