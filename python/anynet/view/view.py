"""Frames, through a predictor, onto the page."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from anynet.camera import Calibration, PairPreparation, PreparedPair
from anynet.cli.results import Writer, file_ids
from anynet.cli.told import tell_warnings
from anynet.errors import AnyNetError, one_line
from anynet.io.files import make_folder
from anynet.predictor import Estimate, Predictor
from anynet.streams import Frame, Source
from anynet.streams.source import check_frame, check_rate, check_source
from anynet.streams.watch import WatchedPreparation
from anynet.trust import Trust, within_reach
from anynet.view.page import Page, Settings
from anynet.visualize import limits_of

Image = npt.NDArray[np.uint8]

_POLL = 0.1  # seconds
_RECENT = 20  # frames that the rate is of


class StillPair(Source):
    """One pair of images, [H, W, 3] uint8 RGB, as a source."""

    def __init__(self, name: str, left: Image, right: Image) -> None:
        super().__init__()
        self._frame = Frame(name, left, right, stamp=time.time_ns(), time=0.0)

    def frames(self) -> Iterator[Frame]:
        yield self._frame

    def close(self) -> None:
        pass


class View:
    """Shows a source's frames on a page until it is stopped; sources that end begin again.

    Args:
        source: of the frames.
        prepare: what is known of the cameras; without a calibration the cloud's shape is right and its size unknown.
        weights: to choose from, the first one chosen.
        input_scale: chosen at first.
        device, precision, threads: see `Predictor`.
        host, port: see `Page`.
        out: folder of what "save" saves.
        rate: frames per second at which recordings are played, in place of their own pace.
        watch: see `Stream`.

    Raises:
        AnyNetError: if viser is missing, or the source, the rate or the first weights cannot be used.
    """

    def __init__(
        self,
        source: Source,
        *,
        prepare: PairPreparation | None = None,
        weights: Sequence[str] = ("default", "paper", "large", "kitti"),
        input_scale: float | None = None,
        device: str = "cpu",
        precision: str = "float32",
        threads: int | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        out: Path = Path("anynet-view"),
        rate: float | None = None,
        watch: bool = True,
    ) -> None:
        check_source(source)
        check_rate(rate)
        self._source = source
        self._prepare = WatchedPreparation(prepare or PairPreparation(check=False), watch)
        self._device, self._precision, self._threads = device, precision, threads
        self._out = out
        self._rate = None if source.live else rate
        self._stopped = threading.Event()
        self._key = weights[0], input_scale
        self._predictor = self._loaded(*self._key)
        self._times: dict[tuple[object, ...], list[float]] = {}
        self._shown: deque[float] = deque(maxlen=_RECENT)
        self.page = Page(host, port, weights, input_scale)
        self.estimate: Estimate | None = None  # the last one shown

    @property
    def url(self) -> str:
        return self.page.url

    def stop(self) -> None:
        """Ends `run` soon, and closes the source. May be called from any thread."""
        self._stopped.set()
        self.page.changed.set()
        self._source.close()  # it may be waiting for a camera that is lost

    def run(self) -> None:
        """Shows frames until `stop`.

        Raises:
            AnyNetError: if the source cannot be read.
        """
        try:
            frames = self._frames()
            if (following := next(frames, None)) is None:
                return
            frame, pair = following
            due = perf_counter()
            while not self._stopped.is_set():
                self.page.changed.clear()
                self._show(frame, pair)
                while not self._stopped.is_set():
                    stepping = self.page.step.is_set()
                    if stepping or (self.page.playing and perf_counter() >= due):
                        self.page.step.clear()
                        if (following := next(frames, None)) is not None:
                            pause = 1 / self._rate if self._rate else max(0.0, following[0].time - frame.time)
                            due = max(perf_counter(), due + pause)
                            frame, pair = following
                            break
                    if self.page.changed.wait(_POLL):
                        break
        except Exception:
            if not self._stopped.is_set():  # else it is what a source says that was closed meanwhile
                raise
        finally:
            try:
                self._source.close()
            finally:
                self.page.close()

    def _frames(self) -> Iterator[tuple[Frame, PreparedPair]]:
        """The source's frames prepared, again and again; of a single one, that one once."""
        while not self._stopped.is_set():
            count = 0
            for frame in self._source.frames():
                check_frame(frame)
                count += 1
                pair, findings = self._prepare(frame)
                tell_warnings(findings, frame.name)
                yield frame, pair
            if not count and not self._stopped.is_set():
                raise AnyNetError("the source has no frames")
            if count == 1 or self._source.live:
                return

    def _show(self, frame: Frame, pair: PreparedPair) -> None:
        settings = self.page.settings()
        try:
            estimate, times = self._compute(pair, settings)
        except (AnyNetError, MemoryError, RuntimeError) as error:  # PyTorch's errors are RuntimeError
            self.page.tell(f"**{one_line(error)}**")
            return
        trust = Trust(settings.min_confidence, settings.drop_occluded)
        kept = pair.known(trust.kept(estimate))
        calibration = pair.calibration or Calibration(focal=float(pair.left.shape[1]), baseline=1.0)
        depth = calibration.depth(kept.copy())
        near = within_reach(depth, calibration, settings.max_depth)
        self.page.show(pair.left, estimate, kept)
        self.page.show_cloud(calibration.points(depth)[near], pair.left[near], calibration)
        self._shown.append(perf_counter())
        self.page.tell(self._status(frame, pair, estimate, times, int(np.count_nonzero(near))))
        self.estimate = estimate
        if self.page.save.is_set():
            self.page.save.clear()
            try:
                self._save(frame, pair, estimate, kept, settings)
            except AnyNetError as error:
                self.page.tell(f"**{error}**")

    def _compute(self, pair: PreparedPair, settings: Settings) -> tuple[Estimate, list[float]]:
        """The best estimate in the budget, and what all stages took when they were last all computed."""
        key = settings.weights, settings.input_scale
        if key != self._key:
            self.page.tell(f"loading `{settings.weights}`")
            self._predictor = self._loaded(*key)
            self._key = key
        predictor = pair.predictor(self._predictor)
        asked: dict[str, Any] = {"confidence": True, "left_right": settings.left_right}
        kind = (*key, pair.left.shape, settings.left_right)
        if kind not in self._times:
            for _ in range(2):  # the first pays for the memory
                estimates = list(predictor.stages(pair.left, pair.right, **asked))
            self._times[kind] = [estimate.elapsed_ms for estimate in estimates]
        times = self._times[kind]
        budget = None if settings.share >= 1.25 else settings.share * times[-1]
        return predictor.predict(pair.left, pair.right, budget, **asked), times

    def _loaded(self, weights: str, input_scale: float | None) -> Predictor:
        return Predictor(
            weights, device=self._device, precision=self._precision, threads=self._threads, input_scale=input_scale
        )

    def _status(self, frame: Frame, pair: PreparedPair, estimate: Estimate, times: list[float], points: int) -> str:
        height, width = pair.left.shape[:2]
        rate = ""
        if len(self._shown) > 1 and self._shown[-1] > self._shown[0]:
            rate = f", {(len(self._shown) - 1) / (self._shown[-1] - self._shown[0]):.1f} pictures/s"
        took = ", ".join(f"{time:.0f}" for time in times)
        unit = "" if pair.calibration is not None else "; no calibration: sizes are unknown"
        return (
            f"**stage {estimate.stage}** of {len(times)} after **{estimate.elapsed_ms:.0f} ms**{rate}  \n"
            f"stages end after {took} ms  \n{frame.name}, {width} x {height}, {points:,} points{unit}"
        )

    def _save(
        self, frame: Frame, pair: PreparedPair, estimate: Estimate, kept: npt.NDArray[np.float32], settings: Settings
    ) -> None:
        make_folder(self._out)
        writer = Writer(self._out, max_depth=settings.max_depth, inputs=file_ids(self._source.files))
        results = writer.of(frame.name)
        results.write_disparity("", kept, limits_of(estimate.disparity))
        results.write_trust(estimate)
        if pair.calibration is not None:
            results.write_depth(kept, pair.calibration, pair.left)
        self.page.tell(f"saved to `{self._out}`: {', '.join(Path(file).name for file in results.files.values())}")
