from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

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
