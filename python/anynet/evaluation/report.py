"""Evaluations as tables (Markdown, JSON) and as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from statistics import fmean, stdev
from typing import Any

import numpy as np

from anynet.data import StereoSample
from anynet.evaluation.evaluate import Evaluation, Method
from anynet.names import numbered
from anynet.visualize import RGBImage, stages_image

Results = dict[tuple[str, str, str], Evaluation]
"""By method, data set and region."""


def markdown(results: Results) -> str:
    """One row per method, data set, region and stage: mean over images, and D1 and EPE over all pixels together."""
    lines = [
        "| method | data | region | pairs | stage | EPE px | bad-1 % | bad-2 % | bad-3 % | D1 % | "
        "EPE px, pooled | D1 %, pooled | density % | ms |",
        "|" + " --- |" * 3 + " ---: |" * 11,
    ]
    for (method, data, region), evaluation in results.items():
        for stage in evaluation.stages:
            mean, pooled = stage.mean, stage.pooled
            counted = sum(image.pixels > 0 for image in stage.images)  # those of which the mean is
            numbers = (mean.epe, mean.bad1, mean.bad2, mean.bad3, mean.d1, pooled.epe, pooled.d1)
            lines.append(
                f"| {method} | {data} | {region} | {counted} | {stage.stage} | "
                + " | ".join(f"{number:.2f}" for number in numbers)
                + f" | {stage.density:.1f} | {stage.milliseconds:.1f} |"
            )
    least = min((evaluation.min_disparity for evaluation in results.values()), default=0)
    lines += ["", f"Mean over images unless it says pooled: over the pixels of all images together. {least} < d < 192."]
    return "\n".join(lines) + "\n"


def to_json(results: Results) -> list[dict[str, Any]]:
    """The same and every image's own scores, for json.dump; names that repeat get numbers."""
    return [
        {
            "method": method,
            "data": data,
            "region": region,
            "stages": [
                {
                    "stage": stage.stage,
                    "milliseconds": stage.milliseconds,
                    "density": stage.density,
                    "mean_over_images": asdict(stage.mean),
                    "pooled_over_pixels": asdict(stage.pooled),
                    "images": dict(zip(numbered(evaluation.names), map(asdict, stage.images), strict=True)),
                }
                for stage in evaluation.stages
            ],
        }
        for (method, data, region), evaluation in results.items()
    ]


def splits_markdown(splits: Sequence[Evaluation]) -> str:
    """The form of the paper's Table II: per stage, D1 as mean and standard deviation over random splits, and time."""
    lines = [f"| stage | D1 %, mean ± standard deviation of {len(splits)} splits | ms |", "| --- | ---: | ---: |"]
    for stages in zip(*(split.stages for split in splits), strict=True):
        d1 = [stage.mean.d1 for stage in stages]
        deviation = stdev(d1) if len(d1) > 1 else 0.0
        milliseconds = fmean(stage.milliseconds for stage in stages)
        lines.append(f"| {stages[0].stage} | {fmean(d1):.2f} ± {deviation:.2f} | {milliseconds:.1f} |")
    return "\n".join(lines) + "\n"


def figure(method: Method, sample: StereoSample) -> RGBImage:
    """Panels as in the paper's Fig. 5: left image, ground truth, every stage, errors of the first and last stage."""
    stages = [(f"stage {e.stage}, {e.elapsed_ms:.0f} ms", e.disparity) for e in method(sample.left, sample.right)]
    return stages_image(sample.left, stages, np.where(sample.valid, sample.disparity, np.float32(np.nan)))
