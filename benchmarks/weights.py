"""Times the packaged weights, stage by stage, beside OpenCV's SGBM.

python benchmarks/weights.py [--threads 2] [--rounds 15] [--processor-time]

One rendered street of 1232x368, images in bytes to full-size disparity. All take turns, so that a machine whose speed
drifts is the same for all; ratios are medians over the turns.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable

import cv2
from measure import HEIGHT, WIDTH, console, median_ratio, options
from rich.table import Table

from anynet import Predictor
from anynet.evaluation.opencv import bm, sgbm
from anynet.predictor import Estimate
from anynet.synthetic import render

SCALES = {"paper": (1, 1.5, 2), "default": (1, 1.5, 2), "large": (1, 1.5, 2, 3), "kitti": (1, 2)}


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--processor-time", action="store_true", help="of all threads; for machines with other work")
    arguments = parser.parse_args()
    cv2.setNumThreads(arguments.threads)
    pair = render(0, HEIGHT, WIDTH, preset="street")
    methods: dict[str, Callable[..., Iterable[Estimate]]] = {"OpenCV SGBM": sgbm, "OpenCV BM": bm}
    for weights, scales in SCALES.items():
        for scale in scales:
            methods[f"{weights}, input_scale={scale:g}"] = Predictor(
                weights, threads=arguments.threads, input_scale=scale
            ).stages
    times: dict[str, list[list[float]]] = {name: [] for name in methods}
    for _ in range(arguments.rounds + 1):
        for name, method in methods.items():
            begin = time.process_time()
            spent = [(e.elapsed_ms, 1e3 * (time.process_time() - begin)) for e in method(pair.left, pair.right)]
            times[name].append([each[arguments.processor_time] for each in spent])
    table = Table("", "ms, by stage", "over SGBM's", title=f"{arguments.threads} thread(s)")
    reference = [stages[-1] for stages in times["OpenCV SGBM"][1:]]
    for name, turns in times.items():
        stages = list(zip(*turns[1:], strict=True))  # the first turn pays for the memory
        ratios = [median_ratio(stage, reference) for stage in stages]
        milliseconds = " ".join(f"{statistics.median(stage):.0f}" for stage in stages)
        table.add_row(name, milliseconds, " ".join(f"{ratio:.2f}" for ratio in ratios))
    console().print(table)


if __name__ == "__main__":
    main()
