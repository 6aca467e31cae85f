"""How good confidences are: sparsification, calibration, and what is left of the error in the surest pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from anynet.camera import PairPreparation
from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import region_mask
from anynet.evaluation.metrics import Mask, within_d1
from anynet.evaluation.prepared import prepared
from anynet.evaluation.truth import check_truth, tell_doubts, with_truth
from anynet.predictor import Predictor
from anynet.samples import StereoSample

BINS = 15  # of confidence, of equal width, for the calibration error
DENSITY = 0.8

Values = npt.NDArray[np.float32]


@dataclass(frozen=True)
class ConfidenceScores:
    """Of one stage over a data set; all but the calibration error are means over images.

    Attributes:
        d1: %, of all counted pixels.
        d1_sparse: %, of the 80 % of them with the highest confidence.
        d1_oracle: %, of the best 80 % that there are.
        ause: area between the sparsification curve and the oracle's, in % of D1 (Ilg et al., arXiv 1802.07095): D1 of
            the pixels that are left when the least sure ones are taken away, over every share taken.
        calibration_error: expected calibration error over the pixels of all images, 0 to 1 (Guo et al., 1706.04599).
        milliseconds: median.
    """

    d1: float
    d1_sparse: float
    d1_oracle: float
    ause: float
    calibration_error: float
    milliseconds: float


def evaluate_confidence(
    predictor: Predictor,
    samples: Sequence[StereoSample],
    region: str = "all",
    *,
    left_right: bool = False,
    prepare: PairPreparation | None = None,
) -> dict[int, ConfidenceScores]:
    """The scores of every stage, by its number; of samples rectified and checked by `prepare`, if that is given.

    Raises:
        AnyNetError: if no pixel counts, or a sample does not tell `region` or is not one of `prepare`'s cameras.
    """
    asked = partial(predictor.stages, confidence=True, left_right=left_right)
    images: dict[int, list[tuple[float, ...]]] = {}
    calibrations: dict[int, Calibration] = {}
    doubts: list[tuple[str, str]] = []
    for pair in prepared(with_truth(samples), prepare):
        sample = pair.sample
        mask = region_mask(sample, region, pair.min_disparity)
        if not mask.any():
            continue
        estimates = list(pair.method(asked)(sample.left, sample.right))
        if not pair.min_disparity:
            doubts += [(sample.name, doubt) for doubt in check_truth(sample, estimates[-1].disparity)]
        for estimate in estimates:
            assert estimate.confidence is not None
            confidence = estimate.confidence[mask]
            correct = within_d1(estimate.disparity[mask], sample.disparity[mask])
            images.setdefault(estimate.stage, []).append((*sparsification(confidence, correct), estimate.elapsed_ms))
            calibrations.setdefault(estimate.stage, Calibration()).add(confidence, correct)
    tell_doubts(doubts)
    if not images:
        raise AnyNetError(f"no pixel of region {region!r} has a disparity that counts")
    scores = {}
    for stage, rows in images.items():
        d1, sparse, oracle, area, _ = map(float, np.mean(rows, axis=0))
        milliseconds = float(np.median([row[-1] for row in rows]))
        scores[stage] = ConfidenceScores(d1, sparse, oracle, area, calibrations[stage].error, milliseconds)
    return scores


def sparsification(confidence: Values, correct: Mask) -> tuple[float, float, float, float]:
    """D1 of all pixels [M], of the 80 % surest, of the 80 % best, and the area between the curves; all in %."""
    count = len(correct)
    left = np.arange(1, count + 1)
    order = np.argsort(-confidence, kind="stable")
    ours = np.cumsum(~correct[order]) / left
    oracle = np.maximum(left - np.count_nonzero(correct), 0) / left
    kept = max(1, round(DENSITY * count)) - 1
    return 100 * ours[-1], 100 * ours[kept], 100 * oracle[kept], 100 * float(np.mean(ours - oracle))


class Calibration:
    """What confidences promise against what comes true, gathered pixel by pixel."""

    def __init__(self) -> None:
        self._count, self._promised, self._correct = np.zeros((3, BINS))

    def add(self, confidence: Values, correct: Mask) -> None:
        """More pixels, [M] each."""
        bins = (confidence * BINS).astype(int).clip(0, BINS - 1)
        self._count += np.bincount(bins, minlength=BINS)
        self._promised += np.bincount(bins, confidence.astype(np.float64), minlength=BINS)
        self._correct += np.bincount(bins, correct, minlength=BINS)

    @property
    def error(self) -> float:
        """Mean, over pixels, of the difference between promise and truth of their bin."""
        return float(np.abs(self._promised - self._correct).sum() / self._count.sum())


Results = Mapping[tuple[str, str, str], Mapping[int, ConfidenceScores]]
"""By weights, data set and region; then by stage."""


def markdown(results: Results) -> str:
    """One row per weights, data set, region and stage."""
    lines = [
        "| weights | data | region | stage | D1 % | D1 % at 80 % density | oracle's | AUSE % | calibration | ms |",
        "|" + " --- |" * 3 + " ---: |" * 7,
    ]
    for (weights, data, region), stages in results.items():
        for stage, s in stages.items():
            lines.append(
                f"| {weights} | {data} | {region} | {stage} | {s.d1:.2f} | {s.d1_sparse:.2f} | {s.d1_oracle:.2f} | "
                f"{s.ause:.2f} | {s.calibration_error:.3f} | {s.milliseconds:.1f} |"
            )
    return "\n".join(lines) + "\n"


def to_json(results: Results) -> list[dict[str, Any]]:
    """The same, for json.dump."""
    return [
        {"weights": weights, "data": data, "region": region, "stages": {n: asdict(s) for n, s in stages.items()}}
        for (weights, data, region), stages in results.items()
    ]
