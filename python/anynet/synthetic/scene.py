"""A scene under construction: random materials and simple solids.

Lengths are in baselines. The world is the left camera's frame turned by a small pitch and roll: y down, the ground
where a scene says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from anynet.synthetic import textures
from anynet.synthetic.geometry import Camera, Vector, rotation
from anynet.synthetic.materials import Material
from anynet.synthetic.surfaces import Patch, Quadric, Relief, Surface
from anynet.synthetic.textures import Image, Rng

ANY = ("noise", "leaves", "gravel", "bricks", "stripes", "wood", "text", "poster", "plain", "fabric", "photo")
ABSTRACT = ("noise", "leaves", "stripes", "poster", "fabric")  # also shown as negatives


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Between `low` and `high`, any octave as likely as any other."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def tone(rng: Rng, light: float = 1.0, weak: bool = False, negative: bool = False) -> Image:
    """A tone curve per channel: brightness, contrast, tint. `weak` leaves little contrast."""
    x = np.linspace(0, 1, 256)[:, None] ** rng.uniform(0.7, 1.5)
    if negative:
        x = 1 - x
    contrast = log_uniform(rng, 0.02, 0.3) if weak else rng.uniform(0.6, 1.15)
    x = (x - 0.5) * contrast + (rng.uniform(0.15, 0.85) if weak else 0.5)
    tint = np.clip(rng.normal(1, 0.2 if weak else 0.07, 3), 0.5, 1.4)
    return np.clip(255 * x * tint * light, 0, 255).astype(np.uint8)[:, None]


def random_angle(rng: Rng) -> float:
    return float(rng.uniform(-np.pi, np.pi))


@dataclass
class Scene:
    rng: Rng
    camera: Camera
    tilt: Vector = field(default_factory=lambda: np.eye(3))
    surfaces: list[Surface] = field(default_factory=list)
    weak: float = 0.0  # least chance of faint texture, whatever the surface

    def pick(self, kinds: Sequence[str]) -> str:
        return kinds[int(self.rng.integers(len(kinds)))]

    def material(
        self,
        kinds: Sequence[str],
        tile: float,
        light: float = 1.0,
        weak: float = 0.1,
        gloss: float = 0.0,
        opacity: float = 1.0,
    ) -> Material:
        """A random material of one of `kinds`; `tile` in baselines, varied by half; `weak`: chance of faint texture."""
        rng = self.rng
        kind = self.pick(kinds)
        return Material(
            kind,
            int(rng.integers(textures.VARIANTS)),
            tile * rng.uniform(0.6, 1.6),
            (rng.uniform(), rng.uniform()),
            turn=kind not in ("facade", "bricks", "sky") and rng.random() < 0.5,
            table=tone(rng, light, rng.random() < max(weak, self.weak), kind in ABSTRACT and rng.random() < 0.15),
            gloss=gloss,
            environment=int(rng.integers(textures.VARIANTS)),
            opacity=opacity,
        )

    def shape(self, *kinds: str) -> tuple[str, int]:
        return self.pick(kinds), int(self.rng.integers(textures.VARIANTS))

    def patch(
        self, origin: Vector, across: Vector, down: Vector, material: Material, cutout: tuple[str, int] | None = None
    ) -> None:
        t = self.tilt
        self.surfaces.append(Patch(t @ origin, t @ across, t @ down, material, cutout))

    def relief(
        self,
        origin: Vector,
        across: Vector,
        down: Vector,
        material: Material,
        cutout: tuple[str, int] | None,
        depth: float,
    ) -> None:
        """`depth`: the surface swells by this share of its distance."""
        t = self.tilt
        variant = int(self.rng.integers(textures.VARIANTS))
        self.surfaces.append(Relief(t @ origin, t @ across, t @ down, material, cutout, variant, depth))

    def quadric(
        self,
        center: Vector,
        frame: Vector,
        radii: Sequence[float],
        material: Material,
        flat: int = 1,
        taper: float = 0.0,
    ) -> None:
        """`frame`: columns are the local axes; the third is a cylinder's or cone's own."""
        axes = (self.tilt @ frame / np.asarray(radii)).T
        light = np.array([self.rng.normal(0, 0.5), -0.8, -0.5])
        self.surfaces.append(Quadric(self.tilt @ center, axes, material, flat, taper, light))

    def at(self, x: float, y: float, disparity: float) -> Vector:
        """The point seen at left pixel (x, y), in the tilted world."""
        c = self.camera
        return np.asarray(self.tilt.T @ np.array([x - c.cx, y - c.cy, c.focal]) / disparity)

    def box(
        self, foot: Vector, size: Sequence[float], frame: Vector, kinds: Sequence[str], tile: float,
        weak: float = 0.1, gloss: float = 0.0, same: bool = False,
    ) -> None:  # fmt: skip
        """A box standing on `foot`; its faces share a material's kind, and one material if `same`."""
        width, height, length = size
        x, y, z = frame[:, 0] * width, -frame[:, 1] * height, frame[:, 2] * length
        center = foot + y / 2
        kind = [self.pick(kinds)]
        shared = self.material(kind, tile, weak=weak, gloss=gloss)
        for normal, across, down in ((z, x, -y), (x, z, -y), (y, x, z)):
            for sign in (-1, 1):
                middle = center + sign * normal / 2
                if sign * normal @ middle >= 0 and sign * normal @ (middle - np.array([1.0, 0, 0])) >= 0:
                    continue  # turned away from both cameras
                light = self.rng.uniform(0.5, 1.2)
                material = shared.lit(light) if same else self.material(kind, tile, light, weak, gloss)
                self.patch(middle - (across + down) / 2, across, down, material)

    def pole(
        self,
        foot: Vector,
        height: float,
        radius: float,
        lean: float = 0.02,
        kinds: Sequence[str] = ANY,
        taper: float = 0.0,
    ) -> None:
        rng = self.rng
        frame = rotation(0, np.pi / 2 + rng.normal(0, lean), rng.normal(0, lean))
        axis = frame[:, 2] * (1 if frame[1, 2] < 0 else -1)
        material = self.material(kinds, max(2.5 * radius, height / 4), weak=0.5, gloss=self.some_gloss(0.2))
        self.quadric(foot + axis * height / 2, frame, (radius, radius, height / 2), material, flat=0, taper=taper)

    def some_gloss(self, chance: float) -> float:
        return float(self.rng.uniform(0.1, 0.4)) if self.rng.random() < chance else 0.0

    def shadow(self, foot: Vector, width: float, length: float) -> None:
        """Darkens the ground around `foot`."""
        reach = np.array([width, 0, 0]), np.array([0, 0, length])
        material = Material("plain", 0, table=np.zeros((256, 1, 3), np.uint8), opacity=self.rng.uniform(0.3, 0.75))
        skew = np.array([self.rng.normal(0, 0.3) * width, -1e-3 * abs(foot[1]), 0])
        self.patch(foot + skew - (reach[0] + reach[1]) / 2, *reach, material, self.shape("soft", "blob"))

    def card(
        self,
        center: Vector,
        width: float,
        height: float,
        frame: Vector,
        material: Material,
        cutout: tuple[str, int] | None,
    ) -> None:
        across, down = frame[:, 0] * width, frame[:, 1] * height
        self.patch(center - (across + down) / 2, across, down, material, cutout)

    def cloth(
        self,
        center: Vector,
        width: float,
        height: float,
        frame: Vector,
        kinds: Sequence[str],
        cut: Sequence[str],
        swell: float,
    ) -> None:
        """A curved piece: cloth, rock, cushion; `swell` as a share of its distance."""
        across, down = frame[:, 0] * width, frame[:, 1] * height
        cutout = self.shape(*cut) if cut else None
        self.relief(center - (across + down) / 2, across, down, self.material(kinds, width), cutout, swell)

    def tube(self, start: Vector, end: Vector, radius: float, material: Material) -> None:
        """An open cylinder between two points."""
        axis = end - start
        length = float(np.linalg.norm(axis))
        axis = axis / length
        side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        frame = np.stack([side, np.cross(axis, side), axis], 1)
        self.quadric((start + end) / 2, frame, (radius, radius, length / 2), material, flat=0)
