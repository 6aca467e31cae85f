"""Curved pieces, as heights over a flat one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.synthetic import textures
from anynet.synthetic.geometry import Camera, Vector, Window, affine
from anynet.synthetic.materials import level_matrix, mip_level
from anynet.synthetic.surfaces.patch import Patch
from anynet.synthetic.surfaces.surface import Fragment
from anynet.synthetic.textures import Field, Image

STEPS = 7  # of the fixed-point iteration that finds the surface in the right view


@dataclass(frozen=True)
class Relief(Patch):
    """A patch whose disparity is multiplied by 1 + height(u, v) * strength: cloth, rock, terrain, a face.

    Everything hangs on the left pixel; the right view finds it as the fixed point of x = x_right + d(x, y).
    """

    variant: int = 0
    strength: float = 0.1

    @property
    def hull(self) -> Vector:
        corners = super().hull
        return np.concatenate([corners / (1 + self.strength), corners / (1 - self.strength)])

    def cast(self, camera: Camera, view: int, window: Window) -> Fragment | None:
        matrix = self.coordinates(camera, 0)
        if matrix is None:
            return None
        height, shade = textures.relief(self.variant)
        cells = height.shape[0] - 1
        x, y = window.grid
        column = np.broadcast_to(x, window.size[::-1])
        disparity = np.zeros(window.size[::-1], np.float32)
        for _ in range(STEPS if view else 1):
            column = x + disparity if view else column
            q = affine(matrix[2], column, y)
            inverse = 1 / np.maximum(q, np.float32(1e-3))
            u, v = (np.asarray(affine(row, column, y) * inverse, np.float32) for row in matrix[:2])
            bump = cv2.remap(height, u * cells, v * cells, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            disparity = q * (1 + np.float32(self.strength) * bump)
        middle = camera.focal / self.depth
        if self.cutout is None:
            inside = (u > 0) & (u < 1) & (v > 0) & (v < 1) & (q > 0)
            coverage = inside.view(np.uint8) * np.uint8(255)
        else:
            masks = textures.shape(*self.cutout)
            n = textures.SHAPE_SIZE
            level = mip_level(masks, n * np.sqrt(abs(np.linalg.det(matrix))) * middle**-1.5)
            s = n * 0.5**level
            mask = cv2.remap(masks[level], u * np.float32(s) - 0.5, v * np.float32(s) - 0.5, cv2.INTER_LINEAR)
            coverage = mask.astype(np.uint8, copy=False)

        def paint(part: Window) -> Image:
            cut = part.within(window)
            color = self._paint_relief(u[cut], v[cut], matrix, middle, shade)
            return self.material.finish(color, part, camera, view)

        return Fragment(window, disparity, coverage, paint)

    def _paint_relief(self, u: Field, v: Field, matrix: NDArray[np.float64], middle: float, shade: Image) -> Image:
        cells = shade.shape[0] - 1
        placement = self.material.placement(float(np.linalg.norm(self.across)), float(np.linalg.norm(self.down)))
        pyramid = textures.texture(self.material.kind, self.material.variant)
        level = mip_level(pyramid, np.sqrt(abs(np.linalg.det(placement @ matrix))) * middle**-1.5)
        texels = level_matrix(level) @ placement
        x, y = affine(texels[0], u, v), affine(texels[1], u, v)
        color = cv2.remap(pyramid[level], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        light = cv2.remap(shade, u * cells, v * cells, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return cv2.multiply(color, cv2.merge([light, light, light]), scale=1 / 128).astype(np.uint8, copy=False)
