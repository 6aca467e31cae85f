"""Times the whole network on the CPU, from images in bytes to disparity, against its peers and the machine's limits.

python benchmarks/pipeline.py [--weights W] [--threads 2] [--json FILE] [--plot FILE] [--sizes]

Peers, each with its best settings, on the same 1x3x368x1232 pair. They get normalized float tensors, while ours starts
from bytes:
* eager: the same network on PyTorch's own operators, inference mode;
* compiled: that through torch.compile, weights frozen (stages 1 to 3: the fourth scans column by column);
* onnxruntime: that exported to ONNX, all graph optimizations, sequential execution;
* openvino: the same ONNX file, latency hint;
* OpenCV's StereoBM and StereoSGBM, 192 disparities.
All take turns, so that a machine whose speed drifts is the same for all. Times are medians of one call in milliseconds,
ratios are medians over the turns. The limit is the multiply-adds over the peak, that of a loop of nothing else in each
turn; a matrix product stands beside it.
"""

from __future__ import annotations

import resource
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import (
    HEIGHT,
    WIDTH,
    Limits,
    console,
    interleaved_ms,
    matrix_product,
    measure_limits,
    median_ratio,
    multiply_adds,
    options,
    pair,
    subplots,
    write_json,
)
from peers import peers
from rich.console import Console
from rich.table import Table
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry

import anynet_ext
from anynet import Predictor, load_checkpoint

CONVOLUTIONS = tuple(f"anynet::{name}" for name in ("stem", "conv3x3", "conv3x3x3", "conv_chain"))


class Counter(TorchDispatchMode):
    """Multiply-adds of the convolutions, and time and traffic of every operator, of one frame."""

    def __init__(self) -> None:
        super().__init__()
        self.multiply_adds = 0
        self.calls: list[tuple[str, float, int, int]] = []  # name, seconds, multiply-adds, bytes

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        start = time.perf_counter()
        out = function(*args, **(kwargs or {}))
        seconds = time.perf_counter() - start
        work = 0
        if function.name() in CONVOLUTIONS:
            work = flop_registry[function.overloadpacket](*args, out_val=out) // 2
            self.multiply_adds += work
        tensors = [t for t in (*args, out) if isinstance(t, Tensor)]
        self.calls.append((function.name(), seconds, work, sum(t.nbytes for t in tensors)))
        return out


def ours(predictor: Predictor) -> dict[str, Callable[[], object]]:
    """Calls of one pair, to each stage."""
    left, right = pair()
    return {
        f"ours, stage {stage}": lambda stage=stage: predictor.predict(left, right, stage=stage)
        for stage in range(1, predictor.config.stages + 1)
    }


def memory_mb(predictor: Predictor) -> float:
    """How far 50 frames raise the process's peak."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(50):
        predictor.predict(*pair())
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024


def count(weights: str, threads: int, stage: int, frames: int) -> tuple[int, list[tuple[str, float, int, int]]]:
    """Multiply-adds of one frame up to a stage, and every operator: name, fastest seconds, multiply-adds, bytes."""
    predictor = Predictor(weights, threads=threads)
    runs = []
    for _ in range(frames):
        with Counter() as counter:
            predictor.predict(*pair(), stage=stage)
        runs.append(counter.calls)
    calls = [(c[0][0], min(x[1] for x in c), c[0][2], c[0][3]) for c in zip(*runs, strict=True)]
    return counter.multiply_adds, calls


def sizes(weights: str, threads: int, out: Console) -> dict[str, Any]:
    """All stages over image sizes of 1/4 to 4 times KITTI's: milliseconds, and the fit a + b * megapixels.

    And over batches of the network in PyTorch, which the predictor's pairs do not make use of.
    """
    predictor = Predictor(weights, threads=threads)
    calls: dict[str, Callable[[], object]] = {}
    megapixels = []
    for factor in (0.5, 0.71, 1.0, 1.41, 2.0):
        height, width = (round(factor * n / 16) * 16 for n in (HEIGHT, WIDTH))
        left, right = pair(height, width)
        calls[f"{height} x {width}"] = lambda left=left, right=right: predictor.predict(left, right)
        megapixels.append(height * width / 1e6)
    growth = {"megapixel": _fit(calls, megapixels, "megapixel", out)}
    model = load_checkpoint(weights).eval()
    batches = {n: torch.rand(2, n, 3, HEIGHT, WIDTH) for n in (1, 2, 4, 8)}
    with torch.inference_mode():
        calls = {f"batch of {n}": lambda images=images: model(*images) for n, images in batches.items()}
        growth["pair"] = _fit(calls, list(batches), "pair", out, rounds=10)
    return growth


def _fit(
    calls: dict[str, Callable[[], object]], amounts: Sequence[float], unit: str, out: Console, rounds: int = 30
) -> dict[str, Any]:
    """Times of the calls, and the straight line through them."""
    times = {name: statistics.median(each) for name, each in interleaved_ms(calls, rounds, slow=1e3).items()}
    for (name, ms), amount in zip(times.items(), amounts, strict=True):
        out.print(f"{name}: {ms:.2f} ms, {ms / amount:.1f} ms per {unit}")
    slope, start = np.polyfit(amounts, list(times.values()), 1)
    worst = max(abs(start + slope * x - ms) / ms for x, ms in zip(amounts, times.values(), strict=True))
    out.print(f"{start:.2f} ms + {slope:.1f} ms per {unit}, within {100 * worst:.0f} %")
    return {"ms": times, "start_ms": start, f"ms_per_{unit}": slope, "largest_deviation": worst}


def roofline(calls: list[tuple[str, float, int, int]], limits: Limits, file: Path) -> None:
    """Every convolution of a frame under the roof of peak arithmetic and copy bandwidth."""
    figure, axes = subplots(figsize=(7, 5))
    intensity = np.logspace(-1, 3, 100)
    axes.loglog(intensity, np.minimum(limits.operations, intensity * limits.bandwidth) / 1e9, "k-", label="limit")
    for name in ("anynet::conv3x3", "anynet::conv3x3x3"):
        points = [(work / traffic, work / seconds / 1e9) for n, seconds, work, traffic in calls if n == name]
        axes.plot(*zip(*points, strict=True), "o", label=name)
    axes.set_xlabel("multiply-adds per byte")
    axes.set_ylabel("10⁹ multiply-adds per second")
    axes.set_title(f"The convolutions of one frame, {limits.threads} thread(s)")
    axes.legend()
    figure.savefig(file, dpi=150)


def goals(times: dict[str, list[float]], work: dict[str, int], memory: float) -> Table:
    """The figures to reach, and what was measured; `work`: multiply-adds by name in `times`."""
    four, three = times["ours, stage 4"], times["ours, stage 3"]
    table = Table("", "measured", "goal")
    for name, goal in (("ours, stage 4", "<= 1.5 x"), ("ours, stage 1", "<= 1.35 x")):
        limit = [ms * work[name] / work["multiply-adds"] for ms in times["multiply-adds"]]
        ms, ratio, floor = statistics.median(times[name]), median_ratio(times[name], limit), statistics.median(limit)
        table.add_row(name, f"{ms:.2f} ms, {ratio:.2f} x the limit of {floor:.2f} ms", goal)
    learned = [name for name in times if name.endswith("3 stages") and not name.startswith("eager")]
    for name in learned:
        goal = ">= 3.5 x" if name.startswith("torch.compile") else ">= 4 x"
        table.add_row(f"3 stages against {name}", f"{median_ratio(times[name], three):.2f} x", goal)
    if learned:
        table.add_row("against OpenCV StereoBM", f"{median_ratio(times['OpenCV StereoBM'], four):.2f} x", "faster")
    if "ours, stage 4, one thread" in times:
        both = median_ratio(times["ours, stage 4, one thread"], four)
        table.add_row("all threads against one, 4 stages", f"{both:.2f} x", ">= 1.7 x")
    table.add_row("peak memory above the loaded model", f"{memory:.0f} MB", "<= 64 MB")
    return table


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--weights", default="paper")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--no-peers", action="store_true", help="only ours and the limits")
    parser.add_argument("--sizes", action="store_true", help="also how the time grows with the image")
    parser.add_argument("--operators", action="store_true", help="also where our time goes")
    parser.add_argument("--json", type=Path, help="write all figures here")
    parser.add_argument("--plot", type=Path, help="write a roofline plot here")
    arguments = parser.parse_args()
    out, threads = console(), arguments.threads
    torch.set_num_threads(threads)
    predictor = Predictor(arguments.weights, threads=threads)
    memory = memory_mb(predictor)
    mine = ours(predictor)
    if threads > 1:
        alone = ours(Predictor(arguments.weights, threads=1))
        mine["ours, stage 4, one thread"] = alone["ours, stage 4"]
    with nullcontext({}) if arguments.no_peers else peers(arguments.weights, threads, out) as others:
        loop = multiply_adds(threads)
        yardsticks = {"multiply-adds": loop, "matrix product": matrix_product()}
        times = interleaved_ms({**yardsticks, **mine, **others}, arguments.rounds)
    limits = measure_limits(threads)
    stages = load_checkpoint(arguments.weights).config.stages
    of_all, calls = count(arguments.weights, threads, stages, frames=20)
    work = {"ours, stage 1": count(arguments.weights, threads, 1, frames=1)[0], f"ours, stage {stages}": of_all}
    work["multiply-adds"] = loop()
    table = Table("", "ms", title=f"{threads} thread(s), 1x3x{HEIGHT}x{WIDTH}")
    for name, each in times.items():
        table.add_row(name, f"{statistics.median(each):.1f}")
    out.print(str(limits), table, goals(times, work, memory))
    if arguments.operators:
        out.print(operators(calls))
    if arguments.plot:
        roofline(calls, limits, arguments.plot)
    growth = sizes(arguments.weights, threads, out) if arguments.sizes else None
    report = {
        "build": anynet_ext.build_info(),
        "threads": threads,
        "ms": {name: [round(ms, 2) for ms in each] for name, each in times.items()},
        "multiply_adds": work,
        "limits": asdict(limits),
        "memory_mb": memory,
        "sizes": growth,
    }
    write_json(arguments.json, report)


def operators(calls: list[tuple[str, float, int, int]]) -> Table:
    """Our time by operator."""
    total: dict[str, list[float]] = defaultdict(lambda: [0, 0.0, 0])
    for name, seconds, work, _ in calls:
        total[name][0] += 1
        total[name][1] += 1e3 * seconds
        total[name][2] += work
    table = Table("operator", "calls", "ms", "10⁹ multiply-adds per second")
    for name, (number, ms, work) in sorted(total.items(), key=lambda item: -item[1][1]):
        if ms >= 0.05:
            table.add_row(name, f"{number:.0f}", f"{ms:.2f}", f"{work / ms / 1e6:.0f}" if work else "")
    return table


if __name__ == "__main__":
    main()
