"""Disparity from images, within the time that the caller has."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from time import perf_counter

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anynet.checkpoint import load_checkpoint
from anynet.errors import AnyNetError
from anynet.model.deploy import DeployedAnyNet
from anynet.scheduler import MAX_THREADS, LatencyTable
from anynet.shutdown import computing

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h


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
        *,
        threads: int | None = None,
        input_scale: float | None = None,
    ) -> None:
        if threads is not None and (type(threads) is not int or not 1 <= threads <= MAX_THREADS):
            raise AnyNetError(f"Predictor: expected threads as an integer from 1 to {MAX_THREADS}, got {threads!r}")
        self._network = DeployedAnyNet(load_checkpoint(weights, input_scale))
        self.config = self._network.config
        self.threads = threads
        self._latencies = LatencyTable(self.config.stages)
        _keep_freed_memory()

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
        """The network's functions, of the images resized, giving disparity in their own size and pixels."""
        zoom = self.config.zoom
        if zoom == 1:
            return self._network.stages(left, right)
        height, width = left.shape[:2]
        size = max(1, round(zoom * width)), max(1, round(zoom * height))
        interpolation = cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR
        images = (torch.from_numpy(cv2.resize(i.numpy(), size, interpolation=interpolation)) for i in (left, right))

        def resized(step: Callable[[], Tensor]) -> Callable[[], Tensor]:
            return lambda: torch.from_numpy(cv2.resize(step().numpy(), (width, height))).mul_(width / size[0])

        return map(resized, self._network.stages(*images))

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
        with computing():
            return self._predict(left, right, budget_ms, stage)

    def _predict(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], budget_ms: float | None, stage: int | None
    ) -> Estimate:
        start = perf_counter()
        images = check_images(left, right)
        if stage is None:
            stage = self.config.stages
        elif type(stage) is not int or not 1 <= stage <= self.config.stages:
            raise AnyNetError(f"predict: expected stage from 1 to {self.config.stages}, got {stage!r}")
        if budget_ms is None:
            budget_ms = math.inf
        elif isinstance(budget_ms, bool) or not isinstance(budget_ms, (int, float)) or not budget_ms >= 0:
            raise AnyNetError(f"predict: expected budget_ms >= 0, got {budget_ms!r}")
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
        with computing():
            if threads != before:
                torch.set_num_threads(threads)
            try:
                with torch.inference_mode():
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


_forked = False


def _after_fork() -> None:
    global _forked
    _forked = True


os.register_at_fork(after_in_child=_after_fork)


@cache
def _keep_freed_memory() -> None:
    """Has glibc keep what a frame frees for the next one, instead of handing it back to be faulted in again.

    For the whole process: PyTorch's volumes of many megabytes come from there.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # not glibc
        return
    mallopt(M_MMAP_THRESHOLD, 32 * 2**20)  # the largest that it takes
    mallopt(M_TRIM_THRESHOLD, 64 * 2**20)
