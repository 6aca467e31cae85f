"""What the benchmarks share: repeated timing, and the machine's limits measured in the same run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch


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


def measure_limits(threads: int) -> Limits:
    """Peaks by a matrix product, which PyTorch's library runs near the machine's best, and by a copy."""
    torch.set_num_threads(threads)
    size = 1024
    one, other, product = (torch.ones(size, size) for _ in range(3))
    product_ms = median_ms(lambda: torch.mm(one, other, out=product))
    source = torch.ones(4 * 2**20)
    target = torch.empty_like(source)
    copy_ms = median_ms(lambda: target.copy_(source))
    return Limits(threads, 1000 * size**3 / product_ms, 1000 * 2 * source.nbytes / copy_ms)
