"""Disparity from images, within the time that the caller has."""

from __future__ import annotations

import ctypes
import math
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from anynet.checkpoint import PACKAGED, find_weights, load_checkpoint
from anynet.device import DeviceClock, find_device, find_precision
from anynet.errors import AnyNetError, one_line
from anynet.frame import Frame, Image, check_images
from anynet.model.confidence import ConfidenceModel
from anynet.model.deploy import DeployedAnyNet
from anynet.model.graphs import GraphedAnyNet
from anynet.samples import MAX_DISPARITY
from anynet.scheduler import MAX_THREADS, LatencyTable, budget_of, check_flags, last_stage_of
from anynet.shutdown import computing
from anynet.waiting import waiting

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h


@dataclass(frozen=True)
class Estimate:
    """A stage's result.

    Attributes:
        stage: 1, the coarsest, to the number of stages, 4 for all packaged weights.
        disparity: [H, W] float32, in pixels of the input: left pixel (y, x) is right pixel (y, x - d). Like all maps,
            an array, or, of images that are tensors, a tensor on their device.
        elapsed_ms: milliseconds from the start of the frame until this estimate was there.
        confidence: [H, W] float32, the probability that the disparity is less than 3 pixels or 5 % off; None unless
            asked for.
        occluded: [H, W] bool, what the other camera does not see; None unless asked for, with the confidence.
    """

    stage: int
    disparity: NDArray[np.float32]
    elapsed_ms: float
    confidence: NDArray[np.float32] | None = field(default=None, kw_only=True)
    occluded: NDArray[np.bool_] | None = field(default=None, kw_only=True)


class Predictor:
    """A network ready to use: images in, disparity out.

    Safe to share between threads. In a forked process it runs on one thread: OpenMP's others do not survive a fork.

    Args:
        weights: the name of packaged weights, or a path (see `anynet.load_checkpoint`).
        device: "cpu"; "cuda", the current GPU; "cuda:1", that one; "auto", the first GPU if there is one, else the CPU.
            On a GPU, the first frame of a size takes longer: it captures CUDA graphs, which the others replay.
        precision: in which type a GPU computes convolutions: "float32", "bfloat16" or "float16". The rest is float32.
        threads: CPU threads to compute on; default: as many as PyTorch uses.
        input_scale: resize the images by this factor first. Above 1 for finer disparity (2 takes four times as long),
            below 1 for images larger than the network was made for, with more than 192 pixels of disparity, or to save
            time. Default: what the weights say.

    Raises:
        AnyNetError: if an argument is not that, or the weights, the device or the precision cannot be used.
    """

    @computing()
    def __init__(
        self,
        weights: str | os.PathLike[str] = "default",
        *,
        device: str = "cpu",
        precision: str = "float32",
        threads: int | None = None,
        input_scale: float | None = None,
    ) -> None:
        if threads is not None and (type(threads) is not int or not 1 <= threads <= MAX_THREADS):
            raise AnyNetError(f"Predictor: expected threads as an integer from 1 to {MAX_THREADS}, got {threads!r}")
        self.device = find_device(device)
        dtype = find_precision(precision, self.device)
        gpu = self.device.type == "cuda"
        network = DeployedAnyNet(load_checkpoint(weights, input_scale), dtype if gpu else None)
        if input_scale is not None and network.config.reach < MAX_DISPARITY:
            reach = f"these weights find disparities below {network.config.reach:.0f} pixels then"
            warnings.warn(f"input_scale {input_scale:g}: {reach}", stacklevel=2)
        self._network: DeployedAnyNet | GraphedAnyNet = network
        self._clock: HostClock | DeviceClock = HostClock()
        self._process = os.getpid()
        if gpu:
            try:
                self._network = GraphedAnyNet(network.to(self.device))
            except RuntimeError as error:  # of CUDA
                raise AnyNetError(f"device {device!r}: {one_line(error)}") from error
            self._clock = DeviceClock(self.device)
        self.config = network.config
        self._path = find_weights(weights).absolute()
        self._confidence: ConfidenceModel | None = None
        with suppress(AnyNetError):  # told when it is asked for
            self._confidence_model()
        self.threads = threads
        self._latencies = LatencyTable(self.config.stages)
        _keep_freed_memory()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _process=os.getpid())
        _keep_freed_memory()

    def stages(
        self,
        left: Image,
        right: Image,
        *,
        confidence: bool = False,
        left_right: bool = False,
        view: str = "left",
    ) -> Iterator[Estimate]:
        """The estimates, each computed when it is asked for; `elapsed_ms` includes the caller's time in between.

        The images are not copied: they must stay as they are until the last estimate has come.

        Args:
            left, right: a rectified pair, [H, W, 3] uint8 RGB of any size: arrays, or tensors on its device.
            confidence: also how far to trust every pixel, and which ones the other camera does not see.
            left_right: judge that by the other view's disparity too, for twice the time.
            view: "left" or "right": whose disparity to give. Right pixel (y, x) is left pixel (y, x + d).

        Raises:
            AnyNetError: if an argument is not that.
        """
        start = perf_counter()
        frame = self._frame("stages", left, right, confidence, left_right, view)
        return self._estimates(frame, start)

    def _estimates(self, frame: Frame, start: float) -> Iterator[Estimate]:
        with inference(self.device, self.threads):
            steps = frame.steps()
        for stage in range(1, self.config.stages + 1):
            with inference(self.device, self.threads):
                maps = frame.maps(stage, *next(steps))
            yield Estimate(stage, maps.disparity, 1e3 * (perf_counter() - start), **maps.trust)

    def _frame(self, method: str, left: Any, right: Any, confidence: object, left_right: object, view: object) -> Frame:
        check_flags(method, confidence=confidence, left_right=left_right)
        if view not in ("left", "right"):
            raise AnyNetError(f"{method}: expected view as 'left' or 'right', got {view!r}")
        images = check_images(left, right, self.device)
        if self.device.type == "cuda" and os.getpid() != self._process:
            raise AnyNetError(f"{method}: expected the process that made the predictor: CUDA does not survive a fork")
        model = self._confidence_model() if confidence else None
        if self.device.type == "cpu" and not _forked:
            waiting().adapt()
        return Frame(
            self._network, self.config.zoom, images, model, bool(left_right),
            device=self.device, mirrored=view == "right", as_arrays=isinstance(left, np.ndarray),
        )  # fmt: skip

    def _confidence_model(self) -> ConfidenceModel:
        """Of these weights, or, uncalibrated, of the packaged ones."""
        if self._confidence is None:
            own = self._path.with_suffix(".confidence.json")
            path = own if own.is_file() else PACKAGED / "default.confidence.json"
            if path != own and self.config.stages != 4:
                raise AnyNetError(f"confidence: expected {own} for a network of {self.config.stages} stages")
            self._confidence = ConfidenceModel.read(path, self.config.stages).to(self.device)
        return self._confidence

    def predict(
        self,
        left: Image,
        right: Image,
        budget_ms: float | None = None,
        stage: int | None = None,
        *,
        confidence: bool = False,
        left_right: bool = False,
        view: str = "left",
    ) -> Estimate:
        """The best estimate that fits.

        Args:
            left, right: a rectified pair, [H, W, 3] uint8 RGB of any size: arrays, or tensors on its device.
            budget_ms: time to keep to. A further stage is begun only if, from what frames of this size took before, it
                will end in time. The first stage is always computed. On a GPU it is the GPU's time that counts.
            stage: the last stage to compute (default: all of them).
            confidence, left_right, view: as of `stages`.

        Raises:
            AnyNetError: if an argument is not that.
        """
        with computing():  # until the last tensor is gone
            return self._predict(left, right, budget_ms, stage, (confidence, left_right, view))

    def _predict(
        self,
        left: Image,
        right: Image,
        budget_ms: float | None,
        stage: int | None,
        asked: tuple[bool, bool, str],
    ) -> Estimate:
        start = perf_counter()
        frame = self._frame("predict", left, right, *asked)
        last = last_stage_of("predict", stage, self.config.stages)
        budget = budget_of("predict", budget_ms)
        with inference(self.device, self.threads) as threads:
            latencies = self._latencies[frame.kind, threads]
            steps = frame.steps()
            prepared = perf_counter() - start
            marks: list[Any] = [self._clock.mark()]
            for reached, latency in enumerate(latencies.stages[:last]):
                if reached and budget < math.inf:
                    elapsed = prepared + self._clock.seconds(marks[0], marks[-1])
                    needed = latency.expected(unknown=elapsed) + latencies.enlarging.expected(unknown=0)
                    if 1e3 * (elapsed + needed) > budget:
                        latency.skipped()
                        break
                results = next(steps)
                marks.append(self._clock.mark())
            else:
                reached = len(marks) - 1
            maps = frame.maps(reached, *results)
            marks.append(self._clock.mark())
        for latency, span in zip((*latencies.stages[:reached], latencies.enlarging), pairwise(marks), strict=True):
            latency.measured(self._clock.seconds(*span))
        return Estimate(reached, maps.disparity, 1e3 * (perf_counter() - start), **maps.trust)


class HostClock:
    """Tells the time that the CPU takes, as `DeviceClock` that of a GPU."""

    def mark(self) -> float:
        return perf_counter()

    def seconds(self, begin: float, end: float) -> float:
        return end - begin


@contextmanager
def inference(device: torch.device, threads: int | None) -> Iterator[int]:
    """Inference mode on so many threads, by default as many as PyTorch uses; gives their number.

    The caller's autocast, which would give operators of float32 other types, does not reach into it.
    """
    before = torch.get_num_threads()
    threads = 1 if _forked else threads or before
    with computing():
        if threads != before:
            torch.set_num_threads(threads)
        try:
            with torch.inference_mode(), torch.autocast(device.type, enabled=False):
                yield threads
        except torch.OutOfMemoryError as error:  # a GPU's
            raise AnyNetError(one_line(error)) from error
        finally:
            if threads != before:
                torch.set_num_threads(before)


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
    mallopt(M_TRIM_THRESHOLD, 256 * 2**20)
