"""A cheap look at whether two images are a rectified pair, left image first, that the network can work on."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from anynet.camera.matches import FEWEST, Matches, match_corners
from anynet.camera.plausibility import MAX_DISPARITY, scale_for

Image = npt.NDArray[np.uint8]

ROWS = 0.5  # pixels that matched corners may lie apart (median)
_BEYOND = 0.05  # of the matches beyond the network's reach: more than go wrong by chance


def check_rectified(
    left: Image,
    right: Image,
    matches: Matches | None = None,
    doffs: float = 0.0,
    reach: float = MAX_DISPARITY,
    hint: str = "",
    smallest: float = 0.0,
) -> list[str]:
    """Matches some hundred corners between the images and looks where the partners lie.

    In a rectified pair the partner of a left pixel lies in the same row and not farther right, except by `doffs`.

    Args:
        left, right: uint8 [H, W, 3] RGB.
        matches: of the pair, if they are at hand.
        doffs: the calibration's: cx of the right camera minus cx of the left, pixels.
        reach: the largest disparity that the network finds, pixels, counted from `smallest` on.
        hint: what to add where rows do not agree.
        smallest: the smallest disparity that is looked for, pixels.

    Returns:
        One sentence per finding, with what was seen; empty for a good pair, and where too few corners match.
    """
    if left.shape == right.shape and min(left.shape[:2]) > 1 and np.array_equal(left, right):
        if (left != left[0, 0]).any():
            return ["left and right are the same picture: give the two images of a pair (or halve one that has both)"]
        return []
    matches = match_corners(left, right) if matches is None else matches
    if not matches.enough:
        return []
    findings = [*_rows(matches, hint), *_swapped(matches, doffs)]
    # Of a pair that is unrectified or exchanged, disparities say nothing more.
    return findings or [*_negative(matches, doffs), *_beyond(matches, reach, smallest)]


def lowest_disparity(matches: Matches) -> float:
    """Below which no more disparities lie than by chance, pixels; infinity if too few are known."""
    disparities = matches.disparities
    return float(np.quantile(disparities, _BEYOND)) + 1 if len(disparities) >= FEWEST else math.inf


def negative_disparities(matches: Matches) -> float:
    """How far the disparities go below 0, pixels; 0 if no more of them do than by chance."""
    return max(0.0, -lowest_disparity(matches))


def _rows(matches: Matches, hint: str) -> list[str]:
    if matches.rows_apart <= ROWS:
        return []
    return [
        f"the pair looks unrectified: {len(matches)} matched corners lie {matches.rows_apart:.1f} rows apart (median), "
        f"expected 0{hint}"
    ]


def _swapped(matches: Matches, doffs: float) -> list[str]:
    offsets = matches.offsets[:, 0]
    moved = np.abs(offsets) > 1
    wrong = np.count_nonzero(moved & (offsets > max(0.0, doffs) + 1))
    if wrong <= np.count_nonzero(moved) / 2 or wrong < FEWEST:
        return []
    return [
        f"left and right look swapped: {wrong} of {np.count_nonzero(moved)} matched corners lie farther right "
        "in the right image"
    ]


def _negative(matches: Matches, doffs: float) -> list[str]:
    below = negative_disparities(matches)
    if below <= max(0.0, doffs) + 1:
        return []
    return [
        f"matched corners have negative disparities, down to {-below:.0f} pixels, which doffs ({doffs:g}) does not "
        f"explain: use --min-disparity {-math.ceil(below + 8)}, and for depth give --doffs"
    ]


def _beyond(matches: Matches, reach: float, smallest: float) -> list[str]:
    disparities = matches.disparities
    beyond = np.count_nonzero(disparities > smallest + reach)
    if beyond < max(FEWEST / 2, _BEYOND * len(disparities)):
        return []
    largest = float(np.quantile(disparities, 0.98))
    start = f" from {smallest:g} on" if smallest else ""
    return [
        f"{beyond} of {len(disparities)} matched corners have disparities above {smallest + reach:g} pixels (up to "
        f"{largest:.0f}), the most that the network finds{start}: use --input-scale {scale_for(largest - smallest)} "
        "or less"
    ]
