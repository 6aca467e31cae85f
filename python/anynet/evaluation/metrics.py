"""Errors of a disparity map against the truth: EPE, bad pixels, D1.

A mask selects the pixels that count; where the prediction is NaN there it is wrong by more than any threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError

Disparity = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


def epe(prediction: Disparity, truth: Disparity, mask: Mask) -> float:
    """End-point error: the mean of |prediction - truth| over `mask`, in pixels; NaN over no pixels. All [H,W]."""
    return scores(prediction, truth, mask).epe


def bad(prediction: Disparity, truth: Disparity, mask: Mask, threshold: float) -> float:
    """Percentage of the pixels of `mask` that are wrong by more than `threshold` pixels."""
    return _percentage(_errors(prediction, truth, mask)[0] > threshold)


def d1(prediction: Disparity, truth: Disparity, mask: Mask) -> float:
    """KITTI's D1: percentage of the pixels of `mask` wrong by more than 3 pixels and by more than 5 % of the truth."""
    return scores(prediction, truth, mask).d1


def within_d1(prediction: Disparity, truth: Disparity) -> Mask:
    """Whether each disparity is right by D1's measure: off by at most 3 pixels or 5 % of the truth."""
    error = np.abs(prediction - truth)
    result: Mask = (error <= 3) | (error <= 0.05 * truth)
    return result


@dataclass(frozen=True)
class Scores:
    """Every metric at once: `epe` in pixels, the others in %; `pixels` counted."""

    epe: float
    bad1: float
    bad2: float
    bad3: float
    d1: float
    pixels: int


METRICS = ("epe", "bad1", "bad2", "bad3", "d1")


def scores(prediction: Disparity, truth: Disparity, mask: Mask) -> Scores:
    """All metrics over the pixels of `mask`; all arguments [H,W]."""
    error, true = _errors(prediction, truth, mask)
    return Scores(
        epe=float(error.mean(dtype=np.float64)) if error.size else float("nan"),
        bad1=_percentage(error > 1),
        bad2=_percentage(error > 2),
        bad3=_percentage(error > 3),
        d1=_percentage((error > 3) & (error > 0.05 * true)),
        pixels=error.size,
    )


def pooled(images: Sequence[Scores]) -> Scores:
    """Over the pixels of all images together, as the KITTI server counts."""
    return _average(images, [image.pixels for image in images])


def mean(images: Sequence[Scores]) -> Scores:
    """The mean of the images' own scores, as the paper counts. Images without a pixel do not count."""
    return _average(images, [int(image.pixels > 0) for image in images])


def _average(images: Sequence[Scores], weights: list[int]) -> Scores:
    counted = [(image, weight) for image, weight in zip(images, weights, strict=True) if weight]
    total = sum(weights)
    averages = {m: sum(getattr(i, m) * w for i, w in counted) / total if total else float("nan") for m in METRICS}
    return Scores(**averages, pixels=sum(image.pixels for image in images))


def _errors(prediction: Disparity, truth: Disparity, mask: Mask) -> tuple[Disparity, Disparity]:
    if not prediction.shape == truth.shape == mask.shape:
        raise AnyNetError(
            f"expected prediction, truth and mask of one shape, got {prediction.shape}, {truth.shape}, {mask.shape}"
        )
    true = truth[mask]
    error = np.abs(prediction[mask] - true)
    error[np.isnan(error)] = np.inf
    return error, true


def _percentage(wrong: Mask) -> float:
    return 100 * float(wrong.mean()) if wrong.size else float("nan")
