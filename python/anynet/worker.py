"""A predictor in the background, for programs that must never wait for it."""

from __future__ import annotations

import atexit
import os
import threading
from dataclasses import dataclass
from time import perf_counter
from types import TracebackType
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from anynet.errors import AnyNetError
from anynet.predictor import Estimate, Predictor, check_images


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
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]


class Worker:
    """Computes the newest frame, stage by stage, on a thread of its own. No method but `close` waits for it.

    Use it as a context manager, or `close` it. All methods may be called from any thread. In a forked process it
    starts afresh, without the frames of its parent.
    """

    def __init__(self, predictor: Predictor) -> None:
        self._predictor = predictor
        self._submitted = 0
        self._closed = False
        self._start_afresh()
        _workers.add(self)

    def _start_afresh(self) -> None:
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._waiting: _Frame | None = None
        self._cancelled = 0  # frames up to this number are not to be worked on
        self._latest: tuple[_Frame, Estimate] | None = None
        self._error: Exception | None = None

    def submit(self, left: NDArray[np.uint8], right: NDArray[np.uint8], stamp: Any = None) -> int:
        """Hands over a frame, in place of one that waits and was not begun; the images are copied.

        Args:
            left, right: a rectified pair, [H, W, 3] uint8 RGB of any size.
            stamp: anything; comes back with the estimates.

        Returns:
            The frame's number: 1, 2, ...

        Raises:
            AnyNetError: if the images are not that, or the worker is closed.
        """
        now = perf_counter()
        check_images(left, right)
        left, right = left.copy(), right.copy()
        with self._changed:
            if self._closed:
                raise AnyNetError("Worker: submit after close")
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="anynet-worker", daemon=True)
                self._thread.start()
            self._submitted += 1
            self._waiting = _Frame(self._submitted, stamp, now, left, right)
            self._changed.notify_all()
            return self._submitted

    def latest(self) -> Latest | None:
        """The best estimate so far of the newest frame that has one; None before the first.

        Raises:
            Exception: what went wrong in the background, once; the worker goes on with the next frame.
        """
        with self._changed:
            error, self._error = self._error, None
            latest = self._latest
        if error is not None:
            raise error
        if latest is None:
            return None
        frame, estimate = latest
        age_ms = 1e3 * (perf_counter() - frame.submitted)
        return Latest(estimate.stage, estimate.disparity, estimate.elapsed_ms, frame.number, frame.stamp, age_ms)

    def cancel(self) -> None:
        """Drops the frame that waits, and the running one after the stage it is in; its estimates so far stay."""
        with self._changed:
            self._waiting = None
            self._cancelled = self._submitted

    def close(self) -> None:
        """Cancels, and waits until the thread has ended; `latest` goes on to work."""
        self.cancel()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting is not None or self._closed)
                if self._closed:
                    return
                frame, self._waiting = self._waiting, None
            assert frame is not None
            try:
                for estimate in self._predictor.stages(frame.left, frame.right):
                    with self._changed:
                        if frame.number <= self._cancelled:
                            break
                        self._latest = frame, estimate
            except Exception as error:  # whatever it is, it belongs to the caller
                with self._changed:
                    self._error = error


_workers: WeakSet[Worker] = WeakSet()


@atexit.register
def _at_exit() -> None:
    """A thread must not be inside PyTorch while the interpreter goes down."""
    for worker in list(_workers):
        worker.close()


def _after_fork() -> None:
    """The thread is not in the child, and may have held the lock."""
    for worker in list(_workers):
        worker._start_afresh()


os.register_at_fork(after_in_child=_after_fork)
