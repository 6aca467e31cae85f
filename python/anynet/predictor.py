"""Disparity from images, within the time that the caller has."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anynet.checkpoint import load_checkpoint
from anynet.errors import AnyNetError
from anynet.inference import InferenceGraph
from anynet.shutdown import computing

INPUT_SCALES = 1 / 16, 4.0  # smallest and largest


@dataclass(frozen=True)
class Estimate:
    """A stage's result.

    Attributes:
        stage: 1, the coarsest, to the number of stages, 4 for all packaged weights.
        disparity: [H, W] float32, in pixels of the input: left pixel (y, x) is right pixel (y, x - d).
        elapsed_ms: milliseconds from the start of the frame until this estimate was there.
    """

    stage: int
    disparity: NDArray[np.float32]
    elapsed_ms: float


class Predictor:
    """A network ready to use: images in, disparity out.

    Safe to share between threads. In a forked process it runs on one thread: OpenMP's others do not survive a fork.

    Args:
        weights: the name of packaged weights, or a path (see `anynet.load_checkpoint`).
        threads: CPU threads to compute on; default: as many as PyTorch uses.
        input_scale: resize the images by this factor first. Above 1 for finer disparity (2 takes four times as long),
            below 1 for images larger than the network was made for, with more than 192 pixels of disparity, or to save
            time. Default: what the weights say.
    """

    def __init__(
        self,
        weights: str | os.PathLike[str] = "default",
        threads: int | None = None,
        input_scale: float | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise AnyNetError(f"Predictor: expected threads >= 1, got {threads}")
        low, high = INPUT_SCALES
        if input_scale is None:
            doubled, self._zoom = None, 1.0
        elif low <= input_scale <= high:
            # The network itself can double the size, without an enlarged image in memory; the rest is done before it.
            doubled = 2 if input_scale >= 2 else 1
            self._zoom = input_scale / doubled
        else:
            raise AnyNetError(f"Predictor: expected input_scale from {low:g} to {high:g}, got {input_scale:g}")
        model = load_checkpoint(weights, doubled)
        if self._zoom > 1:
            model.config = model.config.reaching(self._zoom)
        self.config = model.config
        self.threads = threads
        self._graph = InferenceGraph(model)
        # By height, width and threads.
        self._latencies: defaultdict[tuple[int, int, int], _Latencies] = defaultdict(
            lambda: _Latencies(self.config.stages)
        )

    def stages(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Iterator[Estimate]:
        """The estimates, each computed when it is asked for; `elapsed_ms` includes the caller's time in between.

        Args:
            left, right: a rectified pair, [H, W, 3] uint8 RGB of any size.

        Raises:
            AnyNetError: if the images are not that.
        """
        start = perf_counter()
        images = check_images(left, right)
        return self._estimates(images, start)

    def _estimates(self, images: tuple[Tensor, Tensor], start: float) -> Iterator[Estimate]:
        steps = self._steps(*images)
        for stage in range(1, self.config.stages + 1):
            with self._computing():
                disparity = next(steps)().numpy()
            yield Estimate(stage, disparity, 1e3 * (perf_counter() - start))

    def _steps(self, left: Tensor, right: Tensor) -> Iterator[Callable[[], Tensor]]:
        """The graph's functions, of the images resized, giving disparity in their own size and pixels."""
        if self._zoom == 1:
            return self._graph.stages(left, right)
        height, width = left.shape[:2]
        size = max(1, round(self._zoom * width)), max(1, round(self._zoom * height))
        means = cv2.INTER_AREA if self._zoom < 1 else cv2.INTER_LINEAR
        images = (torch.from_numpy(cv2.resize(image.numpy(), size, interpolation=means)) for image in (left, right))

        def resized(step: Callable[[], Tensor]) -> Callable[[], Tensor]:
            return lambda: torch.from_numpy(cv2.resize(step().numpy(), (width, height))).mul_(width / size[0])

        return map(resized, self._graph.stages(*images))

    def predict(
        self,
        left: NDArray[np.uint8],
        right: NDArray[np.uint8],
        budget_ms: float | None = None,
        stage: int | None = None,
    ) -> Estimate:
        """The best estimate that fits.

        Args:
            left, right: a rectified pair, [H, W, 3] uint8 RGB of any size.
            budget_ms: time to keep to. A further stage is begun only if, from what frames of this size took before, it
                will end in time. The first stage is always computed.
            stage: the last stage to compute (default: all of them).

        Raises:
            AnyNetError: if an argument is not that.
        """
        start = perf_counter()
        images = check_images(left, right)
        if stage is None:
            stage = self.config.stages
        elif not 1 <= stage <= self.config.stages:
            raise AnyNetError(f"predict: expected stage from 1 to {self.config.stages}, got {stage}")
        if budget_ms is None:
            budget_ms = math.inf
        elif not budget_ms >= 0:
            raise AnyNetError(f"predict: expected budget_ms >= 0, got {budget_ms}")
        height, width = left.shape[:2]
        with self._computing() as threads:
            latencies = self._latencies[height, width, threads]
            steps = self._steps(*images)
            begin = start
            for reached, latency in enumerate(latencies.stages[:stage]):
                elapsed = begin - start
                needed = latency.expected(unknown=elapsed) + latencies.enlarging.expected(unknown=0)
                if reached and 1e3 * (elapsed + needed) > budget_ms:
                    latency.skipped()
                    break
                enlarge = next(steps)
                end = perf_counter()
                latency.measured(end - begin)
                begin = end
            else:
                reached = stage
            disparity = enlarge().numpy()
        end = perf_counter()
        latencies.enlarging.measured(end - begin)
        return Estimate(reached, disparity, 1e3 * (end - start))

    @contextmanager
    def _computing(self) -> Iterator[int]:
        """Inference mode on this predictor's threads; gives their number."""
        before = torch.get_num_threads()
        threads = 1 if _forked else self.threads or before
        if threads != before:
            torch.set_num_threads(threads)
        try:
            with computing(), torch.inference_mode():
                yield threads
        finally:
            if threads != before:
                torch.set_num_threads(before)


def check_images(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[Tensor, Tensor]:
    """The images as tensors [H, W, 3] that share their memory where possible."""
    for name, image in (("left", left), ("right", right)):
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            what = f"{image.dtype} {list(image.shape)}" if isinstance(image, np.ndarray) else type(image).__name__
            raise AnyNetError(f"expected {name} as uint8 RGB array [H, W, 3], got {what}")
    if left.shape != right.shape or left.size == 0:
        raise AnyNetError(f"expected two images of one size, got {list(left.shape)} and {list(right.shape)}")
    # PyTorch warns about arrays that are read-only, and cannot take negative strides.
    arrays = (np.require(image, requirements=["C", "W"]) for image in (left, right))
    first, second = (torch.from_numpy(array) for array in arrays)
    return first, second


class _Latency:
    """Seconds that something takes, learnt from the last few times.

    Without a lock: its values are never changed in place, and threads that meet lose at most a measurement.
    """

    RECENT = 16
    PATIENCE = 100  # times in a row to do without before hoping again: the machine may have been busy

    def __init__(self) -> None:
        self._recent: tuple[float, ...] = ()
        self._fastest = math.inf
        self._skips = 0

    def expected(self, unknown: float) -> float:
        """The second slowest of the recent ones, so that one hiccup rules nothing out; `unknown` if there are none."""
        if self._skips >= self.PATIENCE:
            return min(self._fastest, unknown)
        return max(sorted(self._recent)[-2:-1] or self._recent, default=unknown)

    def measured(self, seconds: float) -> None:
        before = () if self._skips >= self.PATIENCE else self._recent
        self._recent = (*before, seconds)[-self.RECENT :]
        self._fastest = min(self._fastest, seconds)
        self._skips = 0

    def skipped(self) -> None:
        self._skips += 1


class _Latencies:
    """What the parts of a frame take, for one image size and number of threads."""

    def __init__(self, stages: int) -> None:
        self.stages = [_Latency() for _ in range(stages)]
        self.enlarging = _Latency()


_forked = False


def _after_fork() -> None:
    global _forked
    _forked = True


os.register_at_fork(after_in_child=_after_fork)
