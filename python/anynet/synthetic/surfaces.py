"""Textured surfaces, seen by either camera of a rectified pair.

Lengths are in baselines, in the left camera's frame (x right, y down, z forward). A point (X, Y, Z) lies at pixel
(cx + f (X - e) / Z, cy + f Y / Z) of view e (0 left, 1 right), and its disparity is f / Z. The ray of a pixel is
r = (x - cx, y - cy, f), so that the point on it with disparity d is r / d (+ the camera's position).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.synthetic import textures
from anynet.synthetic.textures import Field, Image

Vector = NDArray[np.float64]
NEAREST = 0.05  # baselines; whatever comes closer to the cameras is not drawn
STEPS = 7  # of the fixed-point iteration that finds a relief in the right view


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


class Fragment(NamedTuple):
    """What a surface shows to one camera."""

    window: Window
    disparity: Field  # [h, w]
    coverage: Image  # [h, w], 255 = opaque
    paint: Callable[[Window], Image]  # colors [h, w, 3] of a part of the window; costly, so asked only for what is seen


class Surface(Protocol):
    @property
    def depth(self) -> float:
        """Sorts surfaces from back to front; baselines."""

    @property
    def hull(self) -> Vector:
        """Points [N, 3] whose convex hull holds the surface."""

    def cast(self, camera: Camera, view: int, window: Window) -> Fragment | None:
        """What a camera sees of the surface inside the window of its hull; None if nothing."""


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


def _level(pyramid: Sequence[Image], texels_per_pixel: float) -> int:
    return int(np.clip(np.round(np.log2(max(texels_per_pixel, 1e-6)) + 0.2), 0, len(pyramid) - 1))


def _scaled(level: int) -> NDArray[np.float64]:
    """Texel coordinates of the finest level to those of another; texel centers are at integers."""
    s = 0.5**level
    return np.array([[s, 0, s / 2 - 0.5], [0, s, s / 2 - 0.5], [0, 0, 1]])


def _affine(row: NDArray[np.float64], x: Field, y: Field) -> Field:
    a, b, c = (np.float32(v) for v in row)
    return np.asarray(a * x + (b * y + c))


def _dot(vector: Vector, components: Sequence[Field]) -> Field:
    a, b, c = (np.float32(v) for v in vector)
    return np.asarray(a * components[0] + b * components[1] + c * components[2])


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
        disparity = _affine(matrix[2], x, y)
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
        near, far = _level(pyramid, scale * high**-1.5), _level(pyramid, scale * low**-1.5)

        def warped(level: int, part: Window) -> Image:
            move = _scaled(level) @ texels @ part.shift
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
            level = _level(pyramid, np.sqrt(abs(np.linalg.det(texels))) * middle**-1.5)
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            mask = cv2.warpPerspective(pyramid[level], _scaled(level) @ texels, window.size, flags=flags).astype(
                np.uint8, copy=False
            )
        return mask.astype(np.uint8, copy=False)


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
            q = _affine(matrix[2], column, y)
            inverse = 1 / np.maximum(q, np.float32(1e-3))
            u, v = (np.asarray(_affine(row, column, y) * inverse, np.float32) for row in matrix[:2])
            bump = cv2.remap(height, u * cells, v * cells, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            disparity = q * (1 + np.float32(self.strength) * bump)
        middle = camera.focal / self.depth
        if self.cutout is None:
            inside = (u > 0) & (u < 1) & (v > 0) & (v < 1) & (q > 0)
            coverage = inside.view(np.uint8) * np.uint8(255)
        else:
            masks = textures.shape(*self.cutout)
            n = textures.SHAPE_SIZE
            level = _level(masks, n * np.sqrt(abs(np.linalg.det(matrix))) * middle**-1.5)
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
        level = _level(pyramid, np.sqrt(abs(np.linalg.det(placement @ matrix))) * middle**-1.5)
        texels = _scaled(level) @ placement
        x, y = _affine(texels[0], u, v), _affine(texels[1], u, v)
        color = cv2.remap(pyramid[level], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        light = cv2.remap(shade, u * cells, v * cells, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return cv2.multiply(color, cv2.merge([light, light, light]), scale=1 / 128).astype(np.uint8, copy=False)


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
        rays = [_affine(row, x, y) for row in self.axes @ camera.rays]
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
        across, along = _dot(side, s), _dot(up, s)
        across = across * (1 + np.float32(0.35) * across * across)
        wide, tall = float(radius[:2].mean()), float(radius[2])
        texels = self.material.placement(wide, tall)
        pyramid = textures.texture(self.material.kind, self.material.variant)
        pixels = camera.focal / self.depth / textures.SIZE * self.material.tile  # per texel
        level = _level(pyramid, 1 / pixels)
        texels = _scaled(level) @ texels
        mapped = _affine(texels[0], across, along), _affine(texels[1], across, along)
        color = cv2.remap(pyramid[level], *mapped, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP).astype(
            np.uint8, copy=False
        )
        towards = self.axes @ (self.light / np.linalg.norm(self.light)) * np.array([1, 1, self.flat])
        towards /= max(float(np.linalg.norm(towards)), 1e-6)
        glow = _dot(towards, s)
        light = np.clip(128 * (0.8 + 0.45 * glow), 20, 250).astype(np.uint8, copy=False)
        return cv2.multiply(color, cv2.merge([light, light, light]), scale=1 / 128).astype(np.uint8, copy=False)
