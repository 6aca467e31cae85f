"""What the benchmarks share: repeated timing, and the machine's limits measured in the same run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from unittest import mock

import torch

from anynet import network
from anynet_ext import reference

CONVOLUTIONS = ("conv3x3", "conv3x3x3")
OPERATORS = (*CONVOLUTIONS, "batch_norm_relu", "cost_volume", "resize", "soft_argmin", "spatial_propagation", "warp")


@contextmanager
def plain_operators(names: Sequence[str] = OPERATORS) -> Iterator[None]:
    """The network computes these on PyTorch's own operators."""
    with mock.patch.multiple(network, **{name: getattr(reference, name) for name in names}):
        yield


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
    functions: Mapping[str, Callable[[], object]], rounds: int = 30, slow: float = 150.0, slow_rounds: int = 5
) -> dict[str, list[float]]:
    """Times of one call each, round by round, after two that do not count.

    On a machine whose speed drifts, what is to be compared must be measured in the same seconds: compare entries of one
    round. Functions that take more than `slow` milliseconds are in the first `slow_rounds` rounds only.
    """
    times: dict[str, list[float]] = {name: [] for name in functions}
    for round in range(-2, rounds):
        for name, function in functions.items():
            if round >= slow_rounds and statistics.median(times[name]) > slow:
                continue
            start = time.perf_counter()
            function()
            if round >= 0:
                times[name].append(1000 * (time.perf_counter() - start))
    return times


def median_ratio(times: list[float], others: list[float]) -> float:
    """The median of times / others, round by round."""
    return statistics.median(a / b for a, b in zip(times, others, strict=False))


@dataclass(frozen=True)
class Limits:
    """What `threads` threads of this machine can do at most, measured.

    operations: float32 additions, multiplications, absolute values and the like per second, in vectors, counted per
        element; a fused multiply-add counts as one.
    bandwidth: bytes per second, read and written together, of copying arrays of 16 MB.
    """

    threads: int
    operations: float
    bandwidth: float

    def ms(self, operations: float, traffic: float) -> float:
        """No implementation with this much arithmetic and memory traffic can be faster."""
        return 1000 * max(operations / self.operations, traffic / self.bandwidth)


PRODUCT = 1024**3  # multiply-adds of `matrix_product`


def matrix_product() -> Callable[[], object]:
    """What PyTorch's library does near the machine's best."""
    one, other, product = (torch.ones(1024, 1024) for _ in range(3))
    return lambda: torch.mm(one, other, out=product)


def measure_limits(threads: int) -> Limits:
    """Peaks by a matrix product, which PyTorch's library runs near the machine's best, and by a copy."""
    torch.set_num_threads(threads)
    product_ms = median_ms(matrix_product())
    source = torch.ones(4 * 2**20)
    target = torch.empty_like(source)
    copy_ms = median_ms(lambda: target.copy_(source))
    return Limits(threads, 1000 * PRODUCT / product_ms, 1000 * 2 * source.nbytes / copy_ms)
