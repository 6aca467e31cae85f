"""Whether a ground truth can be one: its sign, its range, and its scale against an estimate."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from anynet.samples import MAX_DISPARITY, StereoSample

_FACTOR, _SPREAD = 1.4, 0.15  # truth to estimate, either way; and how little the factor's logarithm may vary (median)
_FEWEST = 100  # pixels


def check_truth(sample: StereoSample, estimate: npt.NDArray[np.float32]) -> list[str]:
    """What is implausible about a sample's disparity, one sentence per finding.

    Args:
        sample: the pair and its truth.
        estimate: a network's disparity of its left view, float32 [H, W], NaN where unknown.
    """
    known = sample.disparity[sample.valid]
    if not known.size:
        return []
    low, high = float(known.min()), float(known.max())
    if high <= 0:
        return [
            f"no pixel counts (0 < d < {MAX_DISPARITY:g}): all known disparities are negative, {low:.4g} to "
            f"{high:.4g}; is the sign the other way round, or depth read in the wrong unit (scale)?"
        ]
    if not ((known > 0) & (known < MAX_DISPARITY)).any():
        return [f"no pixel counts (0 < d < {MAX_DISPARITY:g}): the known disparities are {low:.1f} to {high:.1f}"]
    both = sample.valid & (sample.disparity > 0) & (estimate > 1)
    if np.count_nonzero(both) < _FEWEST:
        return []
    logarithms = np.log(sample.disparity[both] / estimate[both])
    middle = float(np.median(logarithms))
    spread = float(np.median(np.abs(logarithms - middle)))
    if abs(middle) > np.log(_FACTOR) and spread < _SPREAD:
        factor = float(np.exp(middle))
        return [
            f"the true disparities are about {factor:.2g} times the estimated ones everywhere: is their scale right? "
            "(levels per pixel of a PNG: --truth-scale, or scale= of a data set)"
        ]
    return []
