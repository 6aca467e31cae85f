"""A predictor in the background, for programs that must never wait for it."""

from __future__ import annotations

import atexit
import math
import os
import threading
from collections import defaultdict
from dataclasses import dataclass
from numbers import Real
from time import perf_counter
from types import TracebackType
from typing import TYPE_CHECKING, Any
from weakref import WeakSet, finalize

import torch
from torch import Tensor

from anynet.errors import AnyNetError
from anynet.frame import Image, check_images
from anynet.predictor import Estimate, Predictor
from anynet.scheduler import Latency, budget_of, check_flags, last_stage_of

if TYPE_CHECKING:
    from anynet.camera import ShiftedPredictor


@dataclass(frozen=True)
class Latest(Estimate):
    """The newest estimate of the newest frame that has one.

    Attributes:
        frame: the frame's number, as `Worker.submit` returned it.
        stamp: what `Worker.submit` was given with it.
        age_ms: milliseconds since the frame was submitted.
    """

    frame: int
    stamp: Any
    age_ms: float


@dataclass(frozen=True)
class _Frame:
    number: int
    stamp: Any
    submitted: float


class _Copies:
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


class Worker:
    """Computes the newest frame, stage by stage, on a thread of its own. Only `result` and `close` wait for it.

    Use it as a context manager, or `close` it. All methods may be called from any thread. In a forked process it
    starts afresh, without the frames of its parent.

    Args:
        predictor: what computes the frames.
        budget_ms: time for one frame, from when it is begun; as for `Predictor.predict`.
        stage: the last stage to compute (default: all of them).
        preempt: what becomes of the running frame when a newer one is submitted. True: it ends with its first
            estimate, so that every frame begun gives a result, and the newest waits no longer. False: it is finished.
        confidence, left_right: also how far to trust every pixel; as of `Predictor.stages`.

    Raises:
        AnyNetError: if an option is not that.
    """

    def __init__(
        self,
        predictor: Predictor | ShiftedPredictor,
        *,
        budget_ms: float | None = None,
        stage: int | None = None,
        preempt: bool = True,
        confidence: bool = False,
        left_right: bool = False,
    ) -> None:
        if not callable(getattr(predictor, "stages", None)):
            raise AnyNetError(f"Worker: expected a predictor, got {predictor!r}")
        budget = budget_of("Worker", budget_ms)
        stages = getattr(getattr(predictor, "config", None), "stages", None)  # stand-ins have none
        last = last_stage_of("Worker", stage, stages)
        check_flags("Worker", preempt=preempt, confidence=confidence, left_right=left_right)
        # The thread knows this part alone: it ends when the worker itself is forgotten.
        self._loop = _Loop(
            predictor,
            budget,
            math.inf if last is None else last,
            preempt,
            {"confidence": True, "left_right": left_right} if confidence else {},
        )
        finalize(self, self._loop.stop).atexit = False

    def submit(self, left: Image, right: Image, stamp: Any = None) -> int:
        """Hands over a frame, in place of one that waits and was not begun; the images are copied.

        Args:
            left, right: a rectified pair, [H, W, 3] uint8 RGB of any size: what the predictor takes.
            stamp: anything; comes back with the estimates.

        Returns:
            The frame's number: 1, 2, ...

        Raises:
            AnyNetError: if the images are not that, the worker is closed, or its thread cannot be started (the next
                frame tries again).
        """
        now = perf_counter()
        check_images(left, right, getattr(self._loop.predictor, "device", None))
        return self._loop.submit(_Copies(left, right), stamp, now)

    def latest(self) -> Latest | None:
        """The best estimate so far of the newest frame that has one; None before the first.

        Raises:
            Exception: what went wrong in the background, once; the worker goes on with the next frame.
        """
        return self._loop.latest()

    def result(self, timeout: float | None = None) -> Latest | None:
        """Waits for a frame to end, and gives the last estimate of the newest one that ended since the last call.

        Args:
            timeout: seconds to wait at most (default: until a frame ends or the worker is closed).

        Returns:
            None if no frame ended in that time, or the worker is closed.

        Raises:
            AnyNetError: if `timeout` is no number.
            Exception: what went wrong in the background, once; the worker goes on with the next frame.
        """
        if timeout is not None:
            if isinstance(timeout, bool) or not isinstance(timeout, Real) or math.isnan(timeout):
                raise AnyNetError(f"Worker: expected timeout in seconds, got {timeout!r}")
            timeout = float(min(timeout, threading.TIMEOUT_MAX))
        return self._loop.result(timeout)

    def cancel(self) -> None:
        """Drops the frame that waits, and ends the running one after the stage it is in.

        What it has so far stays; if that is nothing, its first estimate still comes, so that `cancel` before each
        `submit` starves nobody.
        """
        self._loop.cancel()

    def close(self) -> None:
        """Cancels, and waits until the thread has ended; `latest` goes on to work."""
        self._loop.stop()
        self._loop.join()

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class _Loop:
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
        self._waiting: tuple[_Frame, _Copies] | None = None
        self._cancelled = 0  # frames up to this number are not to be worked on
        self._latest: tuple[_Frame, Estimate] | None = None
        self._ended: tuple[_Frame, Estimate] | None = None
        self._error: BaseException | None = None
        self._shape: tuple[int, ...] = ()
        self._latencies: defaultdict[int, Latency] = defaultdict(Latency)

    def submit(self, images: _Copies, stamp: Any, now: float) -> int:
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
            self._waiting = _Frame(self._submitted, stamp, now), images
            self._changed.notify_all()
            return self._submitted

    def latest(self) -> Latest | None:
        with self._changed:
            self._raise_error()
            latest = self._latest
        return None if latest is None else _aged(*latest)

    def result(self, timeout: float | None) -> Latest | None:
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._error or self._closed, timeout)
            self._raise_error()
            ended, self._ended = self._ended, None
        return None if ended is None else _aged(*ended)

    def cancel(self) -> None:
        with self._changed:
            self._waiting = None
            self._cancelled = self._submitted

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

    def _compute(self, frame: _Frame, copies: _Copies) -> None:
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
                cancelled = frame.number <= self._cancelled
                if not cancelled or estimate.stage == 1:
                    self._latest = frame, estimate
                if cancelled or estimate.stage >= self._stage or (self._preempt and self._waiting is not None):
                    return
            following = self._latencies[estimate.stage + 1]
            elapsed = end - start
            if 1e3 * (elapsed + following.expected(unknown=elapsed)) > self._budget_ms:
                following.skipped()
                return


def _aged(frame: _Frame, estimate: Estimate) -> Latest:
    age_ms = 1e3 * (perf_counter() - frame.submitted)
    return Latest(**vars(estimate), frame=frame.number, stamp=frame.stamp, age_ms=age_ms)


_loops: WeakSet[_Loop] = WeakSet()


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
