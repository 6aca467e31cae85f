"""How much worse a method becomes by what real rigs do to a pair (`anynet.data.perturb`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from anynet.data.perturb import PERTURBATIONS
from anynet.errors import AnyNetError
from anynet.evaluation.report import Results
from anynet.samples import Dataset, StereoSample

CLEAN = "clean"


class Perturbed(Dataset):
    """The samples with one of `PERTURBATIONS`; the same noise each time."""

    def __init__(self, samples: Sequence[StereoSample], perturbation: str) -> None:
        self.name = perturbation
        self._samples, self._perturb = samples, PERTURBATIONS[perturbation]

    def __len__(self) -> int:
        return len(self._samples)

    def load(self, index: int) -> StereoSample:
        sample = self._samples[index]
        left, right = self._perturb(sample.left, sample.right, np.random.default_rng(index))
        return replace(sample, left=left, right=right)


def chosen(names: Sequence[str]) -> list[str]:
    """The perturbations of these names, "all" meaning every one.

    Raises:
        AnyNetError: if there is none of a name.
    """
    for name in names:
        if name not in (*PERTURBATIONS, "all"):
            raise AnyNetError(f"--perturb: expected all or one of {', '.join(PERTURBATIONS)}, got {name!r}")
    return [name for name in PERTURBATIONS if name in names or "all" in names]


def markdown(results: dict[str, Results]) -> str:
    """One row per method, data set and region: D1 of the last stage, clean and (over clean) with each perturbation.

    What lacks a perturbation is left out.

    results: by perturbation, `CLEAN` first.
    """
    lines = [
        f"| method | data | region | {' | '.join(results)} |",
        "|" + " --- |" * 3 + " ---: |" * len(results),
    ]
    for key in results[CLEAN]:
        if not all(key in by_key for by_key in results.values()):
            continue
        d1 = [by_key[key].stages[-1].mean.d1 for by_key in results.values()]
        cells = [f"{d1[0]:.2f}"] + [f"{value:.2f} ({value / d1[0] if d1[0] else np.inf:.2f}x)" for value in d1[1:]]
        lines.append(f"| {' | '.join((*key, *cells))} |")
    lines += ["", "D1, %, of the last stage, mean over images; in brackets, over that of the clean images."]
    return "\n".join(lines) + "\n"
