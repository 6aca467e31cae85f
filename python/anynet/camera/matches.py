"""Corners that are matched between two images: a cheap look at where a pair's partners lie."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Vectors = npt.NDArray[np.float64]

FEWEST = 20  # matches; with fewer nothing can be said
_LONG_SIDE = 1280  # larger images are looked at in this size: the cost stays below 0.1 s
_SHORTEST_SIDE = 32  # a corner's descriptor needs 31 pixels
_RATIO = 0.75  # Lowe's test: a match counts only if the second best is clearly worse
_WINDOW = 15  # pixels around a corner in which its partner's place is refined
_MOVED = 3.0  # pixels; a refinement that goes farther has found something else


@dataclass(frozen=True, eq=False)
class Matches:
    """Matched corners of a pair.

    Attributes:
        points: [M, 2], x and y in the left image, pixels.
        offsets: [M, 2], where the partner lies in the right image, minus that, pixels.
        size: width and height of the images.
    """

    points: Vectors
    offsets: Vectors
    size: tuple[int, int]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def enough(self) -> bool:
        """Whether anything can be said from them."""
        return len(self) >= FEWEST

    @property
    def disparities(self) -> Vectors:
        """[K], pixels, of those matches that lie in one row as the median of all does, to 2 pixels."""
        rows = self.offsets[:, 1]
        kept = np.abs(rows - np.median(rows)) <= 2 if len(rows) else np.zeros(0, bool)
        disparities: Vectors = -self.offsets[kept, 0]
        return disparities

    @property
    def rows_apart(self) -> float:
        """How many rows the partners lie apart (median), pixels; 0 in a rectified pair."""
        return float(np.median(np.abs(self.offsets[:, 1])))


def match_corners(left: Image, right: Image) -> Matches:
    """Matches some hundred corners between the images, to about a tenth of a pixel.

    Args:
        left, right: uint8 [H, W, 3] RGB of one size.
    """
    height, width = left.shape[:2]
    none = Matches(np.empty((0, 2)), np.empty((0, 2)), (width, height))
    if min(height, width) < _SHORTEST_SIDE:
        return none
    scale = min(1.0, _LONG_SIDE / max(height, width))
    grays = [_gray(image, scale) for image in (left, right)]
    orb = cv2.ORB.create(nfeatures=1000, fastThreshold=10)
    (first, described), (second, other) = (orb.detectAndCompute(gray, None) for gray in grays)
    if described is None or other is None:
        return none
    candidates = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(described, other, k=2)
    pairs = [(a, b) for a, b in (found for found in candidates if len(found) == 2) if a.distance < _RATIO * b.distance]
    if not pairs:
        return none
    points = np.array([first[best.queryIdx].pt for best, _ in pairs], np.float32)
    partners = np.array([second[best.trainIdx].pt for best, _ in pairs], np.float32)
    partners = _refined(grays, points, partners)
    return Matches(points / np.float64(scale), (partners - points) / np.float64(scale), (width, height))


def _gray(image: Image, scale: float) -> Image:
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if scale < 1:
        gray = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(gray, np.uint8)


def _refined(
    grays: list[Image], points: npt.NDArray[np.float32], partners: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """The partners' places between the pixels, from the images' gradients (Lucas and Kanade)."""
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        grays[0], grays[1], points[:, None], partners[:, None].copy(), winSize=(_WINDOW, _WINDOW), maxLevel=0,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    places = np.asarray(found, np.float32)[:, 0]
    good = (np.asarray(status).ravel() == 1) & (np.abs(places - partners).max(axis=1) <= _MOVED)
    return np.where(good[:, None], places, partners)
