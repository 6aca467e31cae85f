"""Whether there is a ground truth, and whether it can be one: its sign, range, and scale against an estimate."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError
from anynet.names import listed
from anynet.samples import MAX_DISPARITY, StereoSample

_FACTOR, _SPREAD = 1.4, 0.15  # truth to estimate, either way; and how little the factor's logarithm may vary (median)
_FEWEST = 100  # pixels
_NAMED = 8  # of the pairs without truth


def counted(sample: StereoSample, min_disparity: float = 0.0) -> npt.NDArray[np.bool_]:
    """Pixels that train and are measured: bool [H, W], known and min_disparity < d < 192."""
    result: npt.NDArray[np.bool_] = (
        sample.valid & (sample.disparity > min_disparity) & (sample.disparity < MAX_DISPARITY)
    )
    return result


def check_counted(what: str, samples: Iterable[StereoSample]) -> None:
    """Looks until it finds a pixel that counts, as a rule at the first sample.

    Raises:
        AnyNetError: if there is none.
    """
    first = ""
    for sample in samples:
        if counted(sample).any():
            return
        first = first or f"{sample.name}: {_uncounted(sample) or 'no known disparity'}"
    raise AnyNetError(f"{what}: expected pairs with known disparities that count, got none; {first}")


def _uncounted(sample: StereoSample) -> str:
    """Why no known pixel of the sample counts; empty if one does, or none is known."""
    known = sample.disparity[sample.valid]
    if not known.size or counted(sample).any():
        return ""
    low, high = float(known.min()), float(known.max())
    if high < 0:
        return (
            f"no pixel counts (0 < d < {MAX_DISPARITY:g}): all known disparities are negative, {low:.4g} to "
            f"{high:.4g}; is the sign the other way round, or depth read in the wrong unit (scale)?"
        )
    return f"no pixel counts (0 < d < {MAX_DISPARITY:g}): the known disparities are {low:.1f} to {high:.1f}"


def with_truth(samples: Sequence[StereoSample]) -> Iterator[StereoSample]:
    """The samples of which some disparity is known, one by one; warns at the end of the others.

    Raises:
        AnyNetError: if there are no samples, or none of which some is known.
    """
    if not len(samples):
        raise AnyNetError("no pairs to evaluate on")
    unknown = []
    for sample in samples:
        if sample.valid.any():
            yield sample
        else:
            unknown.append(sample.name)
    names = listed(unknown, _NAMED)
    if len(unknown) == len(samples):
        raise AnyNetError(f"expected pairs with known disparities to evaluate on, got none: {names}")
    if unknown:
        warnings.warn(f"{names}: no known disparity, left out", stacklevel=2)


def tell_doubts(doubts: Sequence[tuple[str, str]]) -> None:
    """Warns of what `check_truth` said of samples: their names and it."""
    if doubts:
        warnings.warn(f"{listed([name for name, _ in doubts], 1)}: {doubts[0][1]}", stacklevel=3)


def check_truth(sample: StereoSample, estimate: npt.NDArray[np.float32]) -> list[str]:
    """What is implausible about a sample's disparity, one sentence per finding.

    Args:
        sample: the pair and its truth.
        estimate: a network's disparity of its left view, float32 [H, W], NaN where unknown.
    """
    if reason := _uncounted(sample):
        return [reason]
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
