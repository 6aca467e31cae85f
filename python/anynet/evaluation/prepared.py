"""Samples rectified and checked as their cameras need it (`anynet.camera.PairPreparation`), and what is to be said."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from anynet.camera import Calibration, PairPreparation
from anynet.camera.shift import moved_apart, moved_back
from anynet.names import listed
from anynet.samples import StereoSample

if TYPE_CHECKING:
    from anynet.evaluation.evaluate import Image, Method
    from anynet.predictor import Estimate


@dataclass(frozen=True, eq=False)
class PreparedSample:
    """A sample of rectified images.

    Attributes:
        sample: valid where the left camera saw something, too.
        min_disparity: the smallest disparity to look for and to count, pixels.
        calibration: of the images, if known.
    """

    sample: StereoSample
    min_disparity: int = 0
    calibration: Calibration | None = None

    def method(self, method: Method) -> Method:
        """A method for this pair: the one given, or that one on images moved apart."""
        columns = self.min_disparity

        def moved(left: Image, right: Image) -> Iterator[Estimate]:
            for estimate in method(*moved_apart(left, right, columns)):
                yield moved_back(estimate, columns, left)

        return moved if columns else method


def prepared(samples: Iterable[StereoSample], prepare: PairPreparation | None) -> Iterator[PreparedSample]:
    """The samples one by one; warns at the end of what was found or done, each kind once.

    The truth of raw images is taken to be that of the rectified left view.

    Args:
        prepare: what is known of the cameras; None: the images are rectified, and are not looked at.
    """
    if prepare is None:
        yield from map(PreparedSample, samples)
        return
    found: dict[str, tuple[str, list[str]]] = {}  # by kind, the first text and all samples' names
    for sample in samples:
        pair = prepare(sample.left, sample.right)
        raw = ["the truth is taken to be that of the rectified left view"] if pair.valid is not None else []
        for text in (*pair.warnings, *pair.notes, *raw):
            kind = re.sub(r"-?\d[\d.]*", "#", text)
            found.setdefault(kind, (text, []))[1].append(sample.name)
        valid = sample.valid if pair.valid is None else sample.valid & pair.valid
        changed = replace(sample, left=pair.left, right=pair.right, valid=valid)
        yield PreparedSample(changed, pair.min_disparity, pair.calibration)
    for text, names in found.values():
        warnings.warn(f"{listed(names, 1)}: {text}", stacklevel=2)
