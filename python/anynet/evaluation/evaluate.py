"""Runs a method over a data set and scores each of its stages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anynet.camera import PairPreparation
from anynet.errors import AnyNetError
from anynet.evaluation.metrics import Disparity, Mask, Scores, mean, pooled, scores
from anynet.evaluation.prepared import prepared
from anynet.evaluation.truth import check_truth, counted, tell_doubts, with_truth
from anynet.predictor import Estimate
from anynet.samples import StereoSample

Image = npt.NDArray[np.uint8]
Method = Callable[[Image, Image], Iterable[Estimate]]
"""A stereo method: left and right uint8 RGB [H,W,3] -> estimates, one per stage. `Predictor.stages` is one."""

REGIONS = ("all", "noc", "foreground", "background")


@dataclass(frozen=True)
class Stage:
    """Scores of one stage over a data set."""

    stage: int
    images: tuple[Scores, ...]
    """By image, in the order of `Evaluation.names`."""
    milliseconds: float
    """Median over the images, from the same start for every stage. Filling holes is not counted."""
    density: float
    """% of the counted pixels, over all images, that the method gave a value itself. Holes are filled to be scored."""

    @property
    def mean(self) -> Scores:
        """Mean over images."""
        return mean(self.images)

    @property
    def pooled(self) -> Scores:
        """Over the pixels of all images together."""
        return pooled(self.images)


@dataclass(frozen=True)
class Evaluation:
    """A method's stages on one data set and region."""

    names: tuple[str, ...]
    stages: tuple[Stage, ...]
    min_disparity: int = 0
    """The smallest that was looked for, of any image; smaller ones do not count."""


def region_mask(sample: StereoSample, region: str, min_disparity: float = 0.0) -> Mask:
    """Pixels that count: known, min_disparity < d < 192, and in `region`.

    "all": those with known disparity; "noc": of them, those that both cameras see; "foreground", "background".

    Raises:
        AnyNetError: if the sample does not tell the region.
    """
    regions = {
        "all": sample.valid,
        "noc": sample.noc,
        "foreground": sample.foreground,
        "background": None if sample.foreground is None else ~sample.foreground,
    }
    if region not in regions:
        raise AnyNetError(f"expected a region of {', '.join(REGIONS)}, got {region!r}")
    chosen = regions[region]
    if chosen is None:
        raise AnyNetError(f"{sample.name}: the data do not tell {region!r} from other pixels")
    mask: Mask = counted(sample, min_disparity) & chosen
    return mask


def evaluate(
    method: Method, samples: Sequence[StereoSample], region: str = "all", *, prepare: PairPreparation | None = None
) -> Evaluation:
    """Scores `method` on the whole images of `samples`, rectified and checked by `prepare` first, if that is given.

    Raises:
        AnyNetError: if there are no samples, or a sample does not tell `region`, or is not one of `prepare`'s cameras.
    """
    (evaluation,) = compare({"": method}, samples, [region], prepare=prepare).values()
    return evaluation


def compare(
    methods: Mapping[str, Method],
    samples: Sequence[StereoSample],
    regions: Sequence[str] = ("all",),
    *,
    prepare: PairPreparation | None = None,
) -> dict[tuple[str, str], Evaluation]:
    """Scores all `methods` in all `regions`, by name and region.

    The methods take turns, image by image, so that their times can be compared on a machine whose speed drifts.

    Samples without a known disparity are left out, and told.

    Warns if a sample's truth looks wrong, such as in another scale, and of what `prepare` finds. Where that looks for
    disparities from another one than 0 on, those count; its time does not.

    Raises:
        AnyNetError: if there are no samples, none with a known disparity, or a sample does not tell a region.
    """
    names: list[str] = []
    by_stage: dict[tuple[str, str], dict[int, list[tuple[Scores, float, int]]]] = {
        (name, region): {} for name in methods for region in regions
    }
    doubts: list[tuple[str, str]] = []
    least = 0
    for pair in prepared(with_truth(samples), prepare):
        sample = pair.sample
        masks = {region: region_mask(sample, region, pair.min_disparity) for region in regions}
        names.append(sample.name)
        least = min(least, pair.min_disparity)
        for name, method in methods.items():
            # All first: scoring in between would be part of the later stages' times.
            estimates = list(pair.method(method)(sample.left, sample.right))
            if name == next(iter(methods)) and not pair.min_disparity:
                doubts += [(sample.name, doubt) for doubt in check_truth(sample, estimates[-1].disparity)]
            for estimate in estimates:
                whole = fill_holes(estimate.disparity)
                for region, mask in masks.items():
                    given = int(np.isfinite(estimate.disparity[mask]).sum())
                    result = scores(whole, sample.disparity, mask), estimate.elapsed_ms, given
                    by_stage[name, region].setdefault(estimate.stage, []).append(result)
    tell_doubts(doubts)
    return {
        key: Evaluation(
            tuple(names), tuple(_stage(number, results) for number, results in sorted(stages.items())), least
        )
        for key, stages in by_stage.items()
    }


def _stage(number: int, results: list[tuple[Scores, float, int]]) -> Stage:
    images, times, given = zip(*results, strict=True)
    pixels = sum(image.pixels for image in images)
    return Stage(number, images, float(np.median(times)), 100 * sum(given) / pixels if pixels else float("nan"))


def fill_holes(disparity: Disparity) -> Disparity:
    """Fills every hole (NaN) with the smaller, so the farther, of its neighbors in the row; then from other rows."""
    if np.isfinite(disparity).all():
        return disparity
    rows = np.fmin(_forward_fill(disparity), _forward_fill(disparity[:, ::-1])[:, ::-1])
    columns = np.fmin(_forward_fill(rows.T), _forward_fill(rows.T[:, ::-1])[:, ::-1])
    result: Disparity = columns.T
    return result


def _forward_fill(rows: Disparity) -> Disparity:
    """Each pixel's own value or that of the nearest known one to its left; NaN if there is none."""
    columns = np.where(np.isfinite(rows), np.arange(rows.shape[1]), 0)
    result: Disparity = np.take_along_axis(rows, np.maximum.accumulate(columns, axis=1), axis=1)
    return result
