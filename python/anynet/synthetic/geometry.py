"""The cameras of a rectified pair, and windows of their images.

Lengths are in baselines, in the left camera's frame (x right, y down, z forward). A point (X, Y, Z) lies at pixel
(cx + f (X - e) / Z, cy + f Y / Z) of view e (0 left, 1 right), and its disparity is f / Z. The ray of a pixel is
r = (x - cx, y - cy, f), so that the point on it with disparity d is r / d (+ the camera's position).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anynet.synthetic.textures import Field

Vector = NDArray[np.float64]
NEAREST = 0.05  # baselines; whatever comes closer to the cameras is not drawn


def rotation(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Vector:
    """Turns around y, then x, then z (radians)."""
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_x @ about_y)


@dataclass(frozen=True)
class Camera:
    width: int
    height: int
    focal: float  # pixels
    cx: float
    cy: float

    @property
    def rays(self) -> NDArray[np.float64]:
        """Maps (x, y, 1) to the pixel's ray."""
        return np.array([[1, 0, -self.cx], [0, 1, -self.cy], [0, 0, self.focal]])

    def project(self, points: Vector, view: int) -> Vector:
        """Pixels [N, 2] of points [N, 3]."""
        scale = self.focal / points[:, 2:]
        return np.asarray((points[:, :2] - [view, 0]) * scale + [self.cx, self.cy])

    def window(self, hull: Vector, view: int) -> Window | None:
        """The part of the image that the hull of some points [N, 3] covers; None if nothing, or too near."""
        if hull[:, 2].min() < NEAREST:
            return None
        pixels = self.project(hull, view)
        x0, y0 = np.maximum(np.floor(pixels.min(0)), 0)
        x1, y1 = np.minimum(np.ceil(pixels.max(0)) + 1, [self.width, self.height])
        return Window(int(x0), int(y0), int(x1), int(y1)) if x0 < x1 and y0 < y1 else None


class Window(NamedTuple):
    left: int
    top: int
    right: int
    bottom: int

    @property
    def size(self) -> tuple[int, int]:
        """(width, height), as OpenCV wants it."""
        return self.right - self.left, self.bottom - self.top

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def grid(self) -> tuple[Field, Field]:
        """Pixel coordinates: x [1, w], y [h, 1]."""
        x = np.arange(self.left, self.right, dtype=np.float32)
        return x[None], np.arange(self.top, self.bottom, dtype=np.float32)[:, None]

    def within(self, outer: Window) -> tuple[slice, slice]:
        """This window's slices in an array that covers `outer`."""
        left, top = outer.left, outer.top
        return slice(self.top - top, self.bottom - top), slice(self.left - left, self.right - left)

    @property
    def shift(self) -> NDArray[np.float64]:
        """Maps (column, row) inside the window to (x, y) of the image."""
        return np.array([[1, 0, self.left], [0, 1, self.top], [0, 0, 1.0]])


def affine(row: NDArray[np.float64], x: Field, y: Field) -> Field:
    a, b, c = (np.float32(v) for v in row)
    return np.asarray(a * x + (b * y + c))


def dot(vector: Vector, components: Sequence[Field]) -> Field:
    a, b, c = (np.float32(v) for v in vector)
    return np.asarray(a * components[0] + b * components[1] + c * components[2])
