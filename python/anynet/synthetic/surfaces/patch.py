"""Flat surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.synthetic import textures
from anynet.synthetic.geometry import NEAREST, Camera, Vector, Window, affine
from anynet.synthetic.materials import Material, level_matrix, mip_level
from anynet.synthetic.surfaces.surface import Fragment
from anynet.synthetic.textures import Field, Image


@dataclass(frozen=True)
class Patch:
    """The parallelogram origin + u across + v down, u and v in 0..1, of a material, optionally cut out by a shape.

    With (u d, v d, d) = A (x, y, 1) for a fixed matrix A, disparity is affine in pixel coordinates and the texture is
    seen through a homography: both are exact at every pixel.
    """

    origin: Vector
    across: Vector
    down: Vector
    material: Material
    cutout: tuple[str, int] | None = None

    @property
    def depth(self) -> float:
        return float(self.origin[2] + (self.across[2] + self.down[2]) / 2)

    @property
    def hull(self) -> Vector:
        o, u, v = self.origin, self.across, self.down
        return np.array([o, o + u, o + u + v, o + v])

    def coordinates(self, camera: Camera, view: int) -> NDArray[np.float64] | None:
        """The matrix A; None when seen edge-on."""
        frame = np.stack([self.across, self.down, self.origin - np.array([view, 0, 0])], 1)
        if abs(np.linalg.det(frame)) < 1e-9:
            return None
        return np.asarray(np.linalg.inv(frame) @ camera.rays)

    def cast(self, camera: Camera, view: int, window: Window) -> Fragment | None:
        matrix = self.coordinates(camera, view)
        if matrix is None:
            return None
        x, y = window.grid
        disparity = affine(matrix[2], x, y)
        coverage = self._cut(matrix @ window.shift, window, camera, view)
        if self.material.opacity < 1:
            coverage = cv2.convertScaleAbs(coverage, alpha=self.material.opacity).astype(np.uint8, copy=False)

        def paint(part: Window) -> Image:
            color = self._paint(matrix @ part.shift, disparity[part.within(window)])
            return self.material.finish(color, part, camera, view)

        return Fragment(window, disparity, coverage, paint)

    def _paint(self, matrix: NDArray[np.float64], disparity: Field) -> Image:
        pyramid = textures.texture(self.material.kind, self.material.variant)
        size = float(np.linalg.norm(self.across)), float(np.linalg.norm(self.down))
        texels = self.material.placement(*size) @ matrix
        # The area scale of a homography goes with the cube of its denominator, here the disparity.
        scale = np.sqrt(abs(np.linalg.det(texels)))
        low, high = (max(float(d), 1e-3) for d in cv2.minMaxLoc(disparity)[:2])
        near, far = mip_level(pyramid, scale * high**-1.5), mip_level(pyramid, scale * low**-1.5)

        def warped(level: int, part: Window) -> Image:
            move = level_matrix(level) @ texels @ part.shift
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            return cv2.warpPerspective(pyramid[level], move, part.size, flags=flags, borderMode=cv2.BORDER_WRAP)  # type: ignore[return-value]

        height, width = disparity.shape
        if near == far:
            return warped(near, Window(0, 0, width, height))
        color = np.empty((height, width, 3), np.uint8)
        for level in range(near, far + 1):
            farthest = 0.0 if level == far else (scale * 2.0 ** -(level + 0.3)) ** (2 / 3)
            nearest = np.inf if level == near else (scale * 2.0 ** -(level - 0.7)) ** (2 / 3)
            band = cv2.inRange(disparity, farthest, nearest)
            left, top, wide, tall = cv2.boundingRect(band)
            if wide:
                part = Window(left, top, left + wide, top + tall)
                cv2.copyTo(warped(level, part), band[part.slices], color[part.slices])
        return color

    def _cut(self, matrix: NDArray[np.float64], window: Window, camera: Camera, view: int) -> Image:
        if self.cutout is None:
            outline = np.clip(16 * (camera.project(self.hull, view) - window[:2]), -(2.0**24), 2.0**24)
            mask = np.zeros(window.size[::-1], np.uint8)
            cv2.fillConvexPoly(mask, np.round(outline).astype(np.int32), 255, cv2.LINE_AA, 4)
        else:
            pyramid = textures.shape(*self.cutout)
            texels = np.diag([textures.SHAPE_SIZE, textures.SHAPE_SIZE, 1]) @ matrix
            middle = camera.focal / max(self.depth, NEAREST)
            level = mip_level(pyramid, np.sqrt(abs(np.linalg.det(texels))) * middle**-1.5)
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            mask = cv2.warpPerspective(pyramid[level], level_matrix(level) @ texels, window.size, flags=flags).astype(
                np.uint8, copy=False
            )
        return mask.astype(np.uint8, copy=False)
