"""A cheap look at whether two images are a rectified pair, left image first."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

_LONG_SIDE = 1280  # larger images are looked at in this size: the cost stays below 0.1 s
_SHORTEST_SIDE = 32  # a corner's descriptor needs 31 pixels
_FEWEST = 20  # matches; with fewer nothing can be said
_VERTICAL = 1.0  # pixels; on rectified pairs the median is 0, on pairs rotated by 1 degree at least 1.4


def check_rectified(left: npt.NDArray[np.uint8], right: npt.NDArray[np.uint8]) -> list[str]:
    """Matches some hundred corners between the images and looks where the partners lie.

    In a rectified pair the partner of a left pixel lies in the same row and not farther right.

    Args:
        left, right: uint8 [H, W, 3] RGB.

    Returns:
        One sentence per finding, with what was seen; empty for a good pair, and where too few corners match.
    """
    offset = _match_offsets(left, right)
    if len(offset) < _FEWEST:
        return []
    findings = []
    vertical = float(np.median(np.abs(offset[:, 1])))
    if vertical > _VERTICAL:
        findings.append(
            f"the pair looks unrectified: {len(offset)} matched corners lie {vertical:.1f} rows apart (median), "
            "expected 0"
        )
    moved = np.abs(offset[:, 0]) > 1
    wrong = int(np.count_nonzero(offset[moved, 0] > 0))
    if wrong > np.count_nonzero(moved) / 2 and wrong >= _FEWEST:
        findings.append(
            f"left and right look swapped: {wrong} of {np.count_nonzero(moved)} matched corners lie farther right "
            "in the right image"
        )
    return findings


def _match_offsets(left: npt.NDArray[np.uint8], right: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Right minus left position (x, y) of matched corners in pixels, [M, 2]."""
    if min(left.shape[:2]) < _SHORTEST_SIDE:
        return np.empty((0, 2))
    scale = min(1.0, _LONG_SIDE / max(left.shape[:2]))
    orb = cv2.ORB.create(nfeatures=1000, fastThreshold=10)
    keypoints, descriptors = [], []
    for image in (left, right):
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        if scale < 1:
            grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        found, described = orb.detectAndCompute(grey, None)
        if described is None:
            return np.empty((0, 2))
        keypoints.append(np.array([point.pt for point in found]))
        descriptors.append(described)
    candidates = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(descriptors[0], descriptors[1], k=2)
    # Lowe's ratio test: a match counts only if the second best is clearly worse
    pairs = [
        (a.queryIdx, a.trainIdx) for a, b in (c for c in candidates if len(c) == 2) if a.distance < 0.75 * b.distance
    ]
    if not pairs:
        return np.empty((0, 2))
    query, train = np.array(pairs).T
    offset: npt.NDArray[np.float64] = (keypoints[1][train] - keypoints[0][query]) / scale
    return offset
