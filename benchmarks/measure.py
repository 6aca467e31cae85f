"""What the benchmarks share: options, output, repeated timing, and the machine's limits measured in the same run."""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from torch.overrides import TorchFunctionMode

from anynet_ext import reference

HEIGHT, WIDTH = 368, 1232  # KITTI's images, cut to multiples of 16
WIDE = 200  # columns


def options(documentation: str | None, *, threads: int | None = 2) -> argparse.ArgumentParser:
    """The parser of a script's options: its documentation is the help, and `--threads` the first option."""
    parser = argparse.ArgumentParser(description=documentation, formatter_class=argparse.RawDescriptionHelpFormatter)
    if threads is not None:
        parser.add_argument("--threads", type=int, default=threads)
    return parser


def console() -> Console:
    """Prints tables whole where the output is no terminal; rich would cut them to 80 columns."""
    terminal = Console()
    return terminal if terminal.is_terminal else Console(width=WIDE)


def write_json(path: Path | None, report: dict[str, Any]) -> None:
    """Where the user asked for a file."""
    if path is not None:
        path.write_text(json.dumps(report, indent=2) + "\n")


def subplots(**arguments: Any) -> tuple[Figure, Any]:
    """As of pyplot, without a display."""
    matplotlib.use("Agg")
    from matplotlib import pyplot  # after the backend is chosen

    return pyplot.subplots(layout="constrained", **arguments)


def pair(height: int = HEIGHT, width: int = WIDTH) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Smooth texture, the left image shifted by 20 pixels against the right one."""
    random = np.random.default_rng(0)
    coarse = random.integers(0, 256, (height // 8 + 2, width // 8 + 8, 3), dtype=np.uint8)
    texture = cv2.resize(coarse, (width + 20, height), interpolation=cv2.INTER_CUBIC).astype(np.uint8)
    return texture[:, :-20].copy(), texture[:, 20:].copy()


CONVOLUTIONS = ("conv3x3", "conv3x3x3")
OPERATORS = (*CONVOLUTIONS, "batch_norm_relu", "cost_volume", "resize", "soft_argmin", "spatial_propagation", "warp")


class PlainOperators(TorchFunctionMode):
    """Within this context, the operators of these names are PyTorch's own: `anynet_ext.reference`."""

    def __init__(self, names: Sequence[str] = OPERATORS) -> None:
        super().__init__()
        self._names = {f"anynet::{name}" for name in names}

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if isinstance(function, torch._ops.OpOverloadPacket):
            function = function.default
        if isinstance(function, torch._ops.OpOverload) and function.name() in self._names:
            function = reference.of(function)
        return function(*args, **kwargs)


def median_ms(function: Callable[[], object], seconds: float = 0.5, least: int = 7) -> float:
    """Median time of one call, over as many calls as fit into `seconds`, after two that do not count."""
    function()
    function()
    times: list[float] = []
    end = time.perf_counter() + seconds
    while len(times) < least or time.perf_counter() < end:
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return 1000 * statistics.median(times)


def interleaved_ms(
    functions: Mapping[str, Callable[[], object]],
    rounds: int = 30,
    slow: float = 150.0,
    slow_rounds: int = 5,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, list[float]]:
    """Times of one call each by the clock, in milliseconds, round by round, after two that do not count.

    On a machine whose speed drifts, what is to be compared must be measured in the same seconds: compare entries of one
    round. Functions that take more than `slow` milliseconds are in the first `slow_rounds` rounds only.
    """
    times: dict[str, list[float]] = {name: [] for name in functions}
    for round in range(-2, rounds):
        for name, function in functions.items():
            if round >= slow_rounds and statistics.median(times[name]) > slow:
                continue
            start = clock()
            function()
            if round >= 0:
                times[name].append(1000 * (clock() - start))
    return times


def median_ratio(times: list[float], others: list[float]) -> float:
    """The median of times / others, round by round."""
    return statistics.median(a / b for a, b in zip(times, others, strict=False))


@dataclass(frozen=True)
class Limits:
    """What `threads` threads of this machine can do at most, measured.

    loops: float32 multiply-adds per second of a loop of nothing else, by instruction set.
    operations: the same on the instruction set in use. Additions, multiplications, absolute values and the like, in
        vectors, counted per element, are no faster.
    product: multiply-adds per second of PyTorch's matrix product, for comparison: it is no limit.
    bandwidth: bytes per second, read and written together, of copying arrays of 16 MB.
    """

    threads: int
    loops: Mapping[str, float]
    operations: float
    product: float
    bandwidth: float

    def ms(self, operations: float, traffic: float) -> float:
        """No implementation with this much arithmetic and memory traffic can be faster."""
        return 1000 * max(operations / self.operations, traffic / self.bandwidth)

    def __str__(self) -> str:
        loops = ", ".join(f"{name} {rate / 1e9:.0f}" for name, rate in self.loops.items())
        return (
            f"10⁹ multiply-adds per second: {loops}, matrix product {self.product / 1e9:.0f}; "
            f"copy {self.bandwidth / 1e9:.1f} GB/s"
        )


def multiply_adds(threads: int, isa: Any = None) -> Callable[[], int]:
    """A loop of nothing but multiply-adds in registers, some milliseconds long, that returns their number."""
    from anynet_ext import _kernels  # which wheels lack

    return partial(_kernels.multiply_add, isa or _kernels.chosen_isa(), 1_000_000, threads)


PRODUCT = 1024**3  # multiply-adds of `matrix_product`


def matrix_product() -> Callable[[], object]:
    """PyTorch's, of two square matrices."""
    one, other, product = (torch.ones(1024, 1024) for _ in range(3))
    return lambda: torch.mm(one, other, out=product)


def measure_limits(threads: int) -> Limits:
    """Peaks by a loop of multiply-adds and by a copy; a matrix product beside them."""
    from anynet_ext import _kernels

    torch.set_num_threads(threads)
    sets = [isa for isa in _kernels.Isa.__members__.values() if _kernels.isa_available(isa)]
    loops = {isa.name: 1000 * run() / median_ms(run) for isa in sets for run in [multiply_adds(threads, isa)]}
    product_ms = median_ms(matrix_product())
    source = torch.ones(4 * 2**20)
    target = torch.empty_like(source)
    copy_ms = median_ms(lambda: target.copy_(source))
    in_use = loops[_kernels.chosen_isa().name]
    return Limits(threads, loops, in_use, 1000 * PRODUCT / product_ms, 1000 * 2 * source.nbytes / copy_ms)
