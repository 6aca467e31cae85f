"""Ellipsoids, cylinders and cones."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.synthetic import textures
from anynet.synthetic.geometry import Camera, Vector, Window, affine, dot
from anynet.synthetic.materials import Material, level_matrix, mip_level
from anynet.synthetic.surfaces.surface import Fragment
from anynet.synthetic.textures import Field, Image


@dataclass(frozen=True)
class Quadric:
    """An ellipsoid (`flat` 1), or an open cylinder or cone (`flat` 0) around the local third axis.

    The local frame is s = axes (P - center); the surface is s0^2 + s1^2 + flat s2^2 = (1 + taper s2)^2 with |s2| <= 1.
    On a ray, 1/t is the disparity, so the equation is a quadratic in it whose larger root is the nearer hit.
    """

    center: Vector
    axes: NDArray[np.float64]  # rows: local axes divided by the semi-axes
    material: Material
    flat: int = 1
    taper: float = 0.0
    light: Vector = field(default_factory=lambda: np.array([-0.4, -0.8, -0.4]))

    @property
    def depth(self) -> float:
        return float(self.center[2])

    @property
    def hull(self) -> Vector:
        wide = 1 + abs(self.taper)
        corners = np.array([[i * wide, j * wide, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        return np.asarray(self.center + corners @ np.linalg.inv(self.axes).T)

    def cast(self, camera: Camera, view: int, window: Window) -> Fragment | None:
        origin = self.axes @ (np.array([view, 0, 0]) - self.center)
        x, y = window.grid
        rays = [affine(row, x, y) for row in self.axes @ camera.rays]
        o, e, k = origin, self.flat, self.taper
        rim = 1 + k * o[2]
        c2 = o[0] ** 2 + o[1] ** 2 + e * o[2] ** 2 - rim**2
        if c2 <= 0:
            return None  # the camera is inside
        c1 = np.float32(o[0]) * rays[0] + np.float32(o[1]) * rays[1] + np.float32(e * o[2] - rim * k) * rays[2]
        c0 = rays[0] ** 2 + rays[1] ** 2 + np.float32(e - k * k) * rays[2] ** 2
        root = c1 * c1 - np.float32(c2) * c0
        hit = root > 0
        disparity = (np.sqrt(np.where(hit, root, 0)) - c1) * np.float32(1 / c2)
        hit &= disparity > 1e-2
        inverse_d = 1 / np.maximum(disparity, np.float32(1e-2))
        s = [np.float32(o[i]) + rays[i] * inverse_d for i in range(3)]
        hit &= np.abs(s[2]) <= 1
        if not hit.any():
            return None
        solid = hit.view(np.uint8) * np.uint8(255)
        soft = cv2.addWeighted(solid, 0.4, cv2.blur(solid, (3, 3)), 0.6 * self.material.opacity, 0)
        coverage = cv2.bitwise_and(solid, soft)

        def paint(part: Window) -> Image:
            cut = part.within(window)
            color = self._paint([c[cut] for c in s], camera)
            return self.material.finish(color, part, camera, view)

        return Fragment(window, disparity, coverage, paint)

    def _paint(self, s: list[Field], camera: Camera) -> Image:
        """Texture projected along the line from the left camera, in the local frame, and diffuse shading."""
        facing = -self.center / np.linalg.norm(self.center)
        radius = 1 / np.linalg.norm(self.axes, axis=1)  # semi-axes
        forward = self.axes @ facing * np.array([1, 1, self.flat])
        forward /= np.linalg.norm(forward)
        up = np.array([0, 0, 1.0]) if self.flat == 0 or abs(forward[2]) < 0.9 else np.array([0, 1.0, 0])
        side = np.cross(up, forward)
        side /= np.linalg.norm(side)
        up = np.cross(forward, side)
        # Arc length instead of its projection, so that the texture narrows towards the rim.
        across, along = dot(side, s), dot(up, s)
        across = across * (1 + np.float32(0.35) * across * across)
        wide, tall = float(radius[:2].mean()), float(radius[2])
        texels = self.material.placement(wide, tall)
        pyramid = textures.texture(self.material.kind, self.material.variant)
        pixels = camera.focal / self.depth / textures.SIZE * self.material.tile  # per texel
        level = mip_level(pyramid, 1 / pixels)
        texels = level_matrix(level) @ texels
        mapped = affine(texels[0], across, along), affine(texels[1], across, along)
        color = cv2.remap(pyramid[level], *mapped, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP).astype(
            np.uint8, copy=False
        )
        towards = self.axes @ (self.light / np.linalg.norm(self.light)) * np.array([1, 1, self.flat])
        towards /= max(float(np.linalg.norm(towards)), 1e-6)
        glow = dot(towards, s)
        light = np.clip(128 * (0.8 + 0.45 * glow), 20, 250).astype(np.uint8, copy=False)
        return cv2.multiply(color, cv2.merge([light, light, light]), scale=1 / 128).astype(np.uint8, copy=False)
