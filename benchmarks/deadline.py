"""How well a time budget is kept: KITTI-size frames, each with a random budget.

python benchmarks/deadline.py [--weights W] [--frames 1000] [--threads 2] [--busy N] [--passive] [--json FILE]

Counts a frame as late when `Predictor.predict(..., budget_ms=T)` returns later than T + 2 ms, seen from outside. The
first frames are not left out: the latencies are learned from them. Budgets shorter than the first stage, which is
always computed, are drawn too; frames that were late with that stage alone are told apart. With --busy, N processes
that never rest compete for the cores; with --passive, our threads sleep from the start when they wait, and not only
once they are preempted (`anynet_ext.wait_passively`).
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from measure import console, options, pair, write_json
from rich.table import Table

from anynet import Predictor
from anynet_ext import wait_passively

TOLERANCE_MS = 2.0


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Other work, of the same priority."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--weights", default="default")
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--least", type=float, default=5.0, help="shortest budget, ms")
    parser.add_argument("--most", type=float, default=500.0, help="longest budget, ms")
    parser.add_argument("--busy", type=int, default=0, help="processes that compete for the cores")
    parser.add_argument("--passive", action="store_true", help="threads that wait sleep")
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parser.parse_args()

    random = np.random.default_rng(0)
    left, right = pair(375, 1242)
    if arguments.passive:
        wait_passively()
    predictor = Predictor(arguments.weights, threads=arguments.threads)
    budgets = random.uniform(arguments.least, arguments.most, arguments.frames)
    stages, overshoots = [], []
    with busy(arguments.busy):
        for budget in budgets:
            start = time.perf_counter()
            estimate = predictor.predict(left, right, budget_ms=float(budget))
            overshoots.append(1e3 * (time.perf_counter() - start) - budget)
            stages.append(estimate.stage)
    late = np.array(overshoots) > TOLERANCE_MS
    result = {
        "frames": arguments.frames,
        "budgets_ms": [arguments.least, arguments.most],
        "threads": arguments.threads,
        "busy": arguments.busy,
        "late": float(late.mean()),
        "late_with_first_stage": float((late & (np.array(stages) == 1)).mean()),
        "largest_overshoot_ms": float(max(overshoots)),
        "frames_per_stage": {str(stage): stages.count(stage) for stage in range(1, predictor.config.stages + 1)},
    }
    table = Table(
        "frames",
        "budgets",
        "stages 1 / 2 / 3 / 4",
        f"late by > {TOLERANCE_MS:g} ms",
        "of these, by the first stage",
        "worst overshoot",
        "goal",
    )
    table.add_row(
        str(arguments.frames),
        f"{arguments.least:g} to {arguments.most:g} ms",
        " / ".join(str(count) for count in result["frames_per_stage"].values()),
        f"{100 * result['late']:.1f} %",
        f"{100 * result['late_with_first_stage']:.1f} %",
        f"{result['largest_overshoot_ms']:.1f} ms",
        "2 %" if arguments.busy else "1 %",
    )
    console().print(table)
    write_json(arguments.json, result)


if __name__ == "__main__":
    main()
