"""From a source's frames to results: the newest frame wins, nothing queues."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from anynet.camera import PairPreparation, PreparedPair, ShiftedPredictor
from anynet.errors import AnyNetError
from anynet.predictor import Estimate, Predictor
from anynet.streams.source import Frame, Source, check_frame, check_pause, check_rate, check_source
from anynet.streams.watch import WatchedPreparation
from anynet.trust import Trust
from anynet.worker import Worker

_POLL = 0.1  # seconds until a stop is noticed
_TOLD = 20  # warnings that wait to be told
_REMEMBERED = 10_000  # latencies; a stream may run for weeks


@dataclass(frozen=True, eq=False)
class Result:
    """A frame and the best estimate that there was time for.

    Attributes:
        frame: as it came.
        pair: rectified, with its calibration.
        estimate: NaN where the disparity is not known.
        warnings: what looks wrong since the last result, a sentence each.
    """

    frame: Frame
    pair: PreparedPair
    estimate: Estimate
    warnings: tuple[str, ...] = ()


class Statistics:
    """What happened to the frames."""

    def __init__(self) -> None:
        self.read = 0
        self.frames = 0
        self.unpaired = 0, 0  # left and right images that found no partner
        self._stages: Counter[int] = Counter()
        self._latencies: deque[float] = deque(maxlen=_REMEMBERED)
        self._first = self._last = 0.0

    def arrived(self, at: float) -> None:
        self._first = self._first or at
        self.read += 1

    def done(self, result: Result, arrived: float) -> None:
        self._last = perf_counter()
        self.frames += 1
        self._stages[result.estimate.stage] += 1
        self._latencies.append(1e3 * (self._last - arrived))

    def summary(self) -> dict[str, Any]:
        """Numbers of frames with a result, of dropped ones, and of images without a partner, results per second,
        milliseconds from a frame's arrival until its results were written (median, 95th percentile, maximum; of the
        last 10,000), frames by last stage."""
        latency = None
        if self._latencies:
            values = np.percentile(self._latencies, (50, 95, 100))
            latency = {name: round(float(value), 3) for name, value in zip(("p50", "p95", "max"), values, strict=True)}
        seconds = self._last - self._first
        return {
            "frames": self.frames,
            "dropped": self.read - self.frames,
            "unpaired": {"left": self.unpaired[0], "right": self.unpaired[1]},
            "fps": round(self.frames / seconds, 3) if self.frames and seconds > 0 else 0.0,
            "latency_ms": latency or {"p50": None, "p95": None, "max": None},
            "stages": {str(stage): count for stage, count in sorted(self._stages.items())},
        }


class Stream:
    """Reads frames on one thread, computes the newest on another, and hands results to the caller on its own.

    Args:
        source: of the frames; recordings are played at their own pace.
        predictor: computes them.
        prepare: what is known of the cameras; default: the images are a rectified pair.
        budget_ms, stage, confidence, left_right: as for `Worker`.
        trust: what becomes unknown for want of it; makes the confidence be computed.
        rate: frames per second at which a recording is played, in place of its own pace.
        every_frame: a recording waits until each frame has been dealt with: slower or faster, but nothing is dropped.
        watch: look at a frame now and then, whether the cameras have moved, or disparities are too small to be found.

    Raises:
        AnyNetError: if the source or an option is not that.
    """

    def __init__(
        self,
        source: Source,
        predictor: Predictor,
        *,
        prepare: PairPreparation | None = None,
        budget_ms: float | None = None,
        stage: int | None = None,
        confidence: bool = False,
        left_right: bool = False,
        trust: Trust | None = None,
        rate: float | None = None,
        every_frame: bool = False,
        watch: bool = True,
    ) -> None:
        check_source(source)
        check_rate(rate)
        if every_frame and source.live:
            raise AnyNetError("every frame of a live source cannot be kept: it does not wait")
        self.statistics = Statistics()
        self._source = source
        self._predictor = predictor
        self._prepare = WatchedPreparation(prepare or PairPreparation(check=False), watch)
        self._trust = trust or Trust()
        self._rate = rate
        self._every_frame = every_frame
        self._new_worker: Callable[[Predictor | ShiftedPredictor], Worker] = partial(
            Worker, budget_ms=budget_ms, stage=stage, preempt=not every_frame,
            confidence=confidence or self._trust.asked, left_right=left_right,
        )  # fmt: skip
        self._new_worker(predictor).close()  # wrong options are told before the source is read
        self._worker: Worker | None = None
        self._asked = False
        self._begun = threading.Event()
        self._stopped = threading.Event()
        self._read_all = threading.Event()
        self._dealt_with = threading.Semaphore(0)
        self._last = 0  # number of the last frame submitted
        self._warnings: deque[str] = deque(maxlen=_TOLD)
        self._error: BaseException | None = None

    def stop(self) -> None:
        """Ends `results` soon. May be called from any thread and from signal handlers."""
        self._stopped.set()

    def results(self) -> Iterator[Result]:
        """The results as they come, once. While the caller deals with one, newer frames are computed.

        Raises:
            AnyNetError: when the source fails or lies, after the results of the frames before; at once if they were
                asked for before.
        """
        if self._asked:
            raise AnyNetError("expected one call of a stream's `results`, got another: make a new Stream")
        self._asked = True
        return self._run()

    def _run(self) -> Iterator[Result]:
        thread = threading.Thread(target=self._read, name="anynet-stream", daemon=True)
        thread.start()
        try:
            yield from self._results()
        finally:
            self.stop()
            self._dealt_with.release()
            try:
                self._source.close()
            finally:
                thread.join()
                if self._worker is not None:
                    self._worker.close()
        if self._error is not None:
            raise self._error

    def _results(self) -> Iterator[Result]:
        ended = 0
        while not self._stopped.is_set() and not (self._read_all.is_set() and ended == self._last):
            if self._worker is None:
                self._begun.wait(_POLL)
                continue
            latest = self._worker.result(_POLL)
            if latest is None:
                continue
            ended = latest.frame
            frame, pair, arrived = latest.stamp
            estimate = Estimate(
                latest.stage, pair.known(self._trust.kept(latest)), latest.elapsed_ms, confidence=latest.confidence,
                occluded=latest.occluded,
            )  # fmt: skip
            warnings = tuple(self._warnings.popleft() for _ in range(len(self._warnings)))
            result = Result(frame, pair, estimate, warnings)
            yield result
            self.statistics.done(result, arrived)
            self._dealt_with.release()

    def _read(self) -> None:
        try:
            try:
                self._submit_all()
            finally:
                self.statistics.unpaired = self._source.unpaired
        except BaseException as error:
            if not self._stopped.is_set():
                self._error = error
        finally:
            self._read_all.set()
            self._begun.set()

    def _submit_all(self) -> None:
        for frame in self._checked(self._source.frames()):
            arrived = perf_counter()
            self.statistics.arrived(arrived)
            pair, findings = self._prepare(frame)
            self._warnings.extend(findings)
            if self._worker is None:
                self._worker = self._new_worker(pair.predictor(self._predictor))
                self._begun.set()
            self._last = self._worker.submit(pair.left, pair.right, stamp=(frame, pair, arrived))
            if self._every_frame:
                self._dealt_with.acquire()
            if self._stopped.is_set():
                break

    def _checked(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """The frames in time, as long as they have one size."""
        begin, before, size = time.monotonic(), 0.0, None
        for index, frame in enumerate(frames):
            check_frame(frame)
            size = size or frame.left.shape[:2]
            if frame.left.shape[:2] != size:
                sizes = [f"{width} x {height}" for height, width in (size, frame.left.shape[:2])]
                raise AnyNetError(f"frame {frame.name}: expected {sizes[0]} as the frames before, got {sizes[1]}")
            if not self._source.live and not self._every_frame:
                if not self._rate:
                    check_pause(frame, before)
                before = frame.time
                due = begin + (index / self._rate if self._rate else frame.time)
                if self._stopped.wait(max(0.0, due - time.monotonic())):
                    return
            yield frame
