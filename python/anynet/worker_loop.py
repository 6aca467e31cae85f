"""What a worker's thread does, and shares with it: the newest frame, and what there is of it."""

from __future__ import annotations

import atexit
import os
import threading
from collections import defaultdict
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

import torch
from torch import Tensor

from anynet.errors import AnyNetError
from anynet.frame import Image
from anynet.predictor import Estimate, Predictor
from anynet.scheduler import Latency

if TYPE_CHECKING:
    from anynet.camera import ShiftedPredictor


@dataclass(frozen=True)
class Submission:
    """A frame's number, what came with it, and when."""

    number: int
    stamp: Any
    submitted: float


class Copies:
    """The images as they were: of tensors on a GPU, the copy is made when all work before it is done."""

    def __init__(self, left: Image, right: Image) -> None:
        self.images = _copy(left), _copy(right)
        on_gpu = isinstance(left, Tensor) and left.is_cuda
        self._made = torch.cuda.current_stream(left.device).record_event() if on_gpu else None

    def wait(self) -> None:
        """Has this thread's stream wait until they are there."""
        left = self.images[0]
        if self._made is not None and isinstance(left, Tensor):
            torch.cuda.current_stream(left.device).wait_event(self._made)


def _copy(image: Image) -> Image:
    return image.clone() if isinstance(image, Tensor) else image.copy()


class Loop:
    """What the thread and its worker share."""

    def __init__(
        self,
        predictor: Predictor | ShiftedPredictor,
        budget_ms: float,
        stage: float,
        preempt: bool,
        asked: dict[str, Any],
    ) -> None:
        self.predictor = predictor
        self._budget_ms = budget_ms
        self._stage = stage
        self._preempt = preempt
        self._asked = asked  # of every estimate beside the disparity; stand-ins take none
        self._submitted = 0
        self._closed = False
        self.start_afresh()
        _loops.add(self)

    def start_afresh(self) -> None:
        # Of the kind that one thread may take twice: the collector may call `stop` wherever the thread is.
        self._changed = threading.Condition(threading.RLock())
        self._thread: threading.Thread | None = None
        self._waiting: tuple[Submission, Copies] | None = None
        self._canceled = 0  # frames up to this number are not to be worked on
        self._latest: tuple[Submission, Estimate] | None = None
        self._ended: tuple[Submission, Estimate] | None = None
        self._error: BaseException | None = None
        self._shape: tuple[int, ...] = ()
        self._latencies: defaultdict[int, Latency] = defaultdict(Latency)

    def submit(self, images: Copies, stamp: Any, now: float) -> int:
        with self._changed:
            if self._closed:
                raise AnyNetError("Worker: submit after close")
            if self._thread is None:
                thread = threading.Thread(target=self._run, name="anynet-worker", daemon=True)
                try:
                    thread.start()
                except (RuntimeError, MemoryError) as error:
                    raise AnyNetError(f"Worker: cannot start its thread: {error}") from error
                self._thread = thread
            self._submitted += 1
            self._waiting = Submission(self._submitted, stamp, now), images
            self._changed.notify_all()
            return self._submitted

    def latest(self) -> tuple[Submission, Estimate] | None:
        with self._changed:
            self._raise_error()
            return self._latest

    def result(self, timeout: float | None) -> tuple[Submission, Estimate] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._error or self._closed, timeout)
            self._raise_error()
            ended, self._ended = self._ended, None
            return ended

    def cancel(self) -> None:
        with self._changed:
            self._waiting = None
            self._canceled = self._submitted

    def stop(self) -> None:
        with self._changed:
            self._closed = True
            self.cancel()
            self._changed.notify_all()

    def join(self) -> None:
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _run(self) -> None:
        while self._next_frame():
            pass

    def _next_frame(self) -> bool:
        """Waits for a frame and computes it; False if there will be none."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._closed)
            if self._waiting is None:
                return False
            (frame, images), self._waiting = self._waiting, None
        try:
            self._compute(frame, images)
        except BaseException as error:  # whatever it is, it belongs to the caller
            with self._changed:
                self._error = error
                self._changed.notify_all()
        with self._changed:
            if self._latest is not None and self._latest[0] is frame:
                self._ended = self._latest
                self._changed.notify_all()
        return True

    def _compute(self, frame: Submission, copies: Copies) -> None:
        images = copies.images
        if images[0].shape != self._shape:  # what was learned holds for one size
            self._shape, self._latencies = images[0].shape, defaultdict(Latency)
        copies.wait()
        begin = start = perf_counter()
        for estimate in self.predictor.stages(*images, **self._asked):
            end = perf_counter()
            self._latencies[estimate.stage].measured(end - begin)
            begin = end
            with self._changed:
                canceled = frame.number <= self._canceled
                if not canceled or estimate.stage == 1:
                    self._latest = frame, estimate
                if canceled or estimate.stage >= self._stage or (self._preempt and self._waiting is not None):
                    return
            following = self._latencies[estimate.stage + 1]
            elapsed = end - start
            if 1e3 * (elapsed + following.expected(unknown=elapsed)) > self._budget_ms:
                following.skipped()
                return


_loops: WeakSet[Loop] = WeakSet()


@atexit.register
def _at_exit() -> None:
    """A thread must not be inside PyTorch while the interpreter goes down."""
    for loop in list(_loops):
        loop.stop()
        loop.join()


def _after_fork() -> None:
    """The thread is not in the child, and may have held the lock."""
    for loop in list(_loops):
        loop.start_afresh()


os.register_at_fork(after_in_child=_after_fork)
