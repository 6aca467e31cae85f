"""OpenCV's block matchers as methods to compare with."""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter

import cv2
import numpy as np

from anynet.evaluation.evaluate import Image
from anynet.predictor import Estimate
from anynet.samples import MAX_DISPARITY

_RANGE = int(MAX_DISPARITY)


def bm(left: Image, right: Image) -> Iterator[Estimate]:
    """cv2.StereoBM on gray images, blocks of 15x15 pixels."""
    start = perf_counter()
    left, right = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right))  # type: ignore[assignment]
    yield _match(cv2.StereoBM.create(numDisparities=_RANGE, blockSize=15), left, right, start)


def sgbm(left: Image, right: Image) -> Iterator[Estimate]:
    """cv2.StereoSGBM in its three-way mode, blocks of 5x5 pixels, smoothness as OpenCV's documentation suggests."""
    start = perf_counter()
    matcher = cv2.StereoSGBM.create(
        numDisparities=_RANGE,
        blockSize=5,
        P1=8 * 3 * 5**2,
        P2=32 * 3 * 5**2,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    yield _match(matcher, left, right, start)


def _match(matcher: cv2.StereoMatcher, left: Image, right: Image, start: float) -> Estimate:
    """One stage, NaN where the matcher found nothing."""
    # OpenCV gives up on the columns that lack a full range of candidates to their left: lend them some.
    padded = [cv2.copyMakeBorder(image, 0, 0, _RANGE, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    fixed = matcher.compute(*padded)[:, _RANGE:]
    disparity = np.where(fixed >= 0, fixed / np.float32(16), np.float32(np.nan))
    return Estimate(1, disparity, 1e3 * (perf_counter() - start))
