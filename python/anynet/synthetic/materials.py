"""Materials: a texture with its size, place, tone curve and gloss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.synthetic import textures
from anynet.synthetic.geometry import Camera, Window
from anynet.synthetic.textures import Image


@dataclass(frozen=True)
class Material:
    kind: str
    variant: int
    tile: float = 1.0  # side of one texture tile, baselines
    offset: tuple[float, float] = (0.0, 0.0)  # tiles
    turn: bool = False  # exchange the texture's axes
    table: Image | None = None  # [256, 1, 3] tone curve per channel
    opacity: float = 1.0
    gloss: float = 0.0  # share of a mirrored environment in the color
    environment: int = 0  # variant of its texture

    def lit(self, light: float) -> Material:
        """The same material under brighter (> 1) or dimmer light."""
        identity = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, 2)
        table = identity if self.table is None else self.table
        return replace(self, table=np.clip(table * light, 0, 255).astype(np.uint8))

    def placement(self, width: float, height: float) -> NDArray[np.float64]:
        """Maps (u, v, 1) of a surface of this size in baselines to texels of the finest level."""
        size, (ou, ov) = textures.SIZE, self.offset
        a, b = size * width / self.tile, size * height / self.tile
        if max(a, b) < size:  # stay inside the tile where that is possible: no seam
            ou, ov = ou * (1 - max(a, b) / size), ov * (1 - max(a, b) / size)
        if self.turn:
            return np.array([[0, b, ou * size], [a, 0, ov * size], [0, 0, 1]])
        return np.array([[a, 0, ou * size], [0, b, ov * size], [0, 0, 1]])

    def finish(self, color: Image, window: Window, camera: Camera, view: int) -> Image:
        """Tone curve, and the reflection of surroundings that seem to lie at another depth than the surface."""
        if self.table is not None:
            color = cv2.LUT(color, self.table).astype(np.uint8, copy=False)
        if self.gloss:
            mirror = textures.texture("leaves", self.environment)[2]
            virtual = camera.width / 40 * (self.environment % 5)  # disparity of what is mirrored
            size = mirror.shape[0]
            move = np.array([[size / camera.width, 0, 0], [0, size / camera.width, 0]]) @ (
                np.array([[1, 0, view * virtual], [0, 1, 0], [0, 0, 1]]) @ window.shift
            )
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            seen = cv2.warpAffine(mirror, move, window.size, flags=flags, borderMode=cv2.BORDER_WRAP)
            color = cv2.addWeighted(color, 1 - self.gloss, seen, self.gloss, 0).astype(np.uint8, copy=False)
        return color


def mip_level(pyramid: Sequence[Image], texels_per_pixel: float) -> int:
    return int(np.clip(np.round(np.log2(max(texels_per_pixel, 1e-6)) + 0.2), 0, len(pyramid) - 1))


def level_matrix(level: int) -> NDArray[np.float64]:
    """Texel coordinates of the finest level to those of another; texel centers are at integers."""
    s = 0.5**level
    return np.array([[s, 0, s / 2 - 0.5], [0, s, s / 2 - 0.5], [0, 0, 1]])
