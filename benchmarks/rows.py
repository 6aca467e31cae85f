"""How well `--fix-rows` finds rows that are off: real pairs, the right image lowered and turned by known amounts.

python benchmarks/rows.py kitti2015:DATA/kitti2015
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator

import cv2
import numpy as np

from anynet.camera import fit_rows, match_corners
from anynet.data import StereoSample, open_dataset
from anynet.data.perturb import PERTURBATIONS

CASES = {"as they are": (0.0, 0.0), "rows1": (1.0, 0.0), "rows2": (2.0, 0.0), "roll": (0.0, 0.3)}  # pixels, degrees


def measured(samples: list[StereoSample], kind: str) -> Iterator[tuple[float, float, float]]:
    """Shift in pixels, roll in degrees, and milliseconds of one core for finding and removing them; of each pair."""
    for sample in samples:
        left, right = sample.left, sample.right
        if kind in PERTURBATIONS:
            left, right = PERTURBATIONS[kind](left, right, np.random.default_rng(0))
        begin = time.process_time()
        rows = fit_rows(match_corners(left, right))
        if rows is None:
            yield math.nan, math.nan, math.nan
            continue
        rows.corrected(right)
        yield rows.shift, math.degrees(rows.roll), 1e3 * (time.process_time() - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", help="pairs, as `anynet evaluate --data`")
    samples = list(open_dataset(parser.parse_args().data))
    cv2.setNumThreads(1)
    print("| right image | pairs | shift px, mean and deviation | roll degrees, mean and deviation | "
          "within 0.2 px and 0.05 degrees | ms |")  # fmt: skip
    print("| --- |" + " ---: |" * 5)
    for kind, (shift, roll) in CASES.items():
        found = np.array(list(measured(samples, kind)))
        known = found[np.isfinite(found[:, 0])]
        good = (np.abs(known[:, 0] - shift) <= 0.2) & (np.abs(known[:, 1] - roll) <= 0.05)
        mean, deviation = known.mean(axis=0), known.std(axis=0)
        print(
            f"| {kind} | {len(known)} of {len(found)} | {mean[0]:.2f} ± {deviation[0]:.2f} | "
            f"{mean[1]:.3f} ± {deviation[1]:.3f} | {good.sum()} | {np.median(known[:, 2]):.0f} |"
        )


if __name__ == "__main__":
    main()
