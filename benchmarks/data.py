"""Time of the renderer per scene kind, and of reading and augmenting a stored pair; one thread, milliseconds.

python benchmarks/data.py
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from measure import options

from anynet.data.augment import augment
from anynet.data.rendered import RenderedFolder, write_rendered
from anynet.synthetic import MIXTURE, PRESETS, render

SIZE, CROP, SCENES = (384, 768), (256, 512), 8


def each(run: Callable[[int], object], count: int) -> float:
    """Milliseconds per call of run(0) ... run(count - 1), after one round to fill caches (the texture bank)."""
    for i in range(count):
        run(i)
    start = time.perf_counter()
    for i in range(count):
        run(i)
    return 1e3 * (time.perf_counter() - start) / count


def main() -> None:
    options(__doc__, threads=None).parse_args()
    cv2.setNumThreads(1)
    times = {preset: each(lambda seed, p=preset: render(seed, *SIZE, preset=p), SCENES) for preset in PRESETS}
    for preset, milliseconds in times.items():
        print(f"render {preset:8} {SIZE[0]} x {SIZE[1]}: {milliseconds:6.1f} ms")
    print(f"render, default mixture:    {sum(MIXTURE[p] * t for p, t in times.items()):6.1f} ms")
    with tempfile.TemporaryDirectory() as folder:
        list(write_rendered(Path(folder), 4, height=SIZE[0], width=SIZE[1]))
        pairs = RenderedFolder(folder)
        crops = each(lambda i: augment(pairs[i % len(pairs)], CROP, np.random.default_rng(i)), 100)
    print(f"read + augment, {CROP[0]} x {CROP[1]}:  {crops:6.1f} ms")


if __name__ == "__main__":
    main()
