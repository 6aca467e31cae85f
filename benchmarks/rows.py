"""How well `--fix-rows` finds rows that are off: real pairs, the right image lowered and turned by known amounts.

    python benchmarks/rows.py kitti2015:DATA/kitti2015

Real pairs have errors of their own, so what is found is also compared with what is found in the pair as it is.
"""

from __future__ import annotations

import argparse
import math
import time

import cv2
import numpy as np

from anynet.camera import fit_rows, match_corners
from anynet.data import StereoSample, open_dataset
from anynet.data.perturb import PERTURBATIONS

CASES = {"as it is": (0.0, 0.0), "rows1": (1.0, 0.0), "rows2": (2.0, 0.0), "roll": (0.0, 0.3)}  # pixels, degrees
SHIFT, ROLL = 0.2, 0.05  # what is good: pixels, degrees


def found(sample: StereoSample, kind: str) -> tuple[float, float, float]:
    """Shift in pixels, roll in degrees (NaN: not found), and milliseconds of one core for finding and removing them."""
    left, right = sample.left, sample.right
    if kind in PERTURBATIONS:
        left, right = PERTURBATIONS[kind](left, right, np.random.default_rng(0))
    begin = time.process_time()
    rows = fit_rows(match_corners(left, right))
    if rows is None:
        return math.nan, math.nan, math.nan
    rows.corrected(right)
    return rows.shift, math.degrees(rows.roll), 1e3 * (time.process_time() - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", help="pairs, as `anynet evaluate --data`")
    samples = open_dataset(parser.parse_args().data)
    cv2.setNumThreads(1)
    values = np.array([[found(sample, kind) for kind in CASES] for sample in samples])  # [pairs, cases, 3]
    print("| right image | pairs | shift, px | roll, degrees | largest error beyond the pair's own | within 0.2 px and "
          "0.05 degrees of that | ms |")  # fmt: skip
    print("| --- |" + " ---: |" * 6)
    for index, (kind, truth) in enumerate(CASES.items()):
        known = values[np.isfinite(values[:, [0, index]]).all(axis=(1, 2))]
        mean, deviation = known[:, index].mean(axis=0), known[:, index].std(axis=0)
        errors = np.abs(known[:, index, :2] - known[:, 0, :2] - truth)
        good = (errors <= (SHIFT, ROLL)).all(axis=1).sum()
        print(
            f"| {kind} | {len(known)} of {len(values)} | {mean[0]:.2f} ± {deviation[0]:.2f} | "
            f"{mean[1]:.3f} ± {deviation[1]:.3f} | {errors[:, 0].max():.2f} px, {errors[:, 1].max():.3f} degrees | "
            f"{good} | {np.median(known[:, index, 2]):.0f} |"
        )


if __name__ == "__main__":
    main()
