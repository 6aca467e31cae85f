"""A predictor in the background, for programs that must never wait for it."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from numbers import Real
from time import perf_counter
from types import TracebackType
from typing import TYPE_CHECKING, Any
from weakref import finalize

from anynet.errors import AnyNetError
from anynet.frame import Image, check_images
from anynet.predictor import Estimate, Predictor
from anynet.scheduler import budget_of, check_flags, last_stage_of
from anynet.worker_loop import Copies, Loop, Submission

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
        self._loop = Loop(
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
        return self._loop.submit(Copies(left, right), stamp, now)

    def latest(self) -> Latest | None:
        """The best estimate so far of the newest frame that has one; None before the first.

        Raises:
            Exception: what went wrong in the background, once; the worker goes on with the next frame.
        """
        return _aged(self._loop.latest())

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
            if isinstance(timeout, bool) or not isinstance(timeout, Real) or timeout != timeout:
                raise AnyNetError(f"Worker: expected timeout in seconds, got {timeout!r}")
            timeout = float(max(0, min(timeout, threading.TIMEOUT_MAX)))
        return _aged(self._loop.result(timeout))

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


def _aged(ended: tuple[Submission, Estimate] | None) -> Latest | None:
    if ended is None:
        return None
    frame, estimate = ended
    age_ms = 1e3 * (perf_counter() - frame.submitted)
    return Latest(**vars(estimate), frame=frame.number, stamp=frame.stamp, age_ms=age_ms)
