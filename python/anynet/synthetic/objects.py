"""What scenes are made of: random materials, and objects from boxes to trees and machines.

Lengths are in baselines. The world is the left camera's frame turned by a small pitch and roll: y down, the ground
where a scene says.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from anynet.synthetic import textures
from anynet.synthetic.surfaces import Camera, Material, Patch, Quadric, Relief, Surface, Vector
from anynet.synthetic.textures import Image, Rng

ANY = ("noise", "leaves", "gravel", "bricks", "stripes", "wood", "text", "poster", "plain", "fabric", "photo")
ABSTRACT = ("noise", "leaves", "stripes", "poster", "fabric")  # also shown as negatives


def rotation(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Vector:
    """Turns around y, then x, then z (radians)."""
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_x @ about_y)


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

    # Objects. `foot` is the middle of an object's base; sizes are width, height, length.

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

    def bush(self, foot: Vector, width: float, height: float, layers: int) -> None:
        """Layers of leaves with holes, each bulging, some way behind one another."""
        rng = self.rng
        for layer in range(layers):
            frame = rotation(rng.normal(0, 0.4), rng.normal(0, 0.3), rng.uniform(0, 6.3) if layer else 0)
            middle = foot - [0, height / 2, 0] + rng.normal(0, 0.15, 3) * [width, height, width * 1.5]
            kind = ("blob", "canopy") if layer == 0 else ("canopy",)
            material = self.material(("foliage",), height * 0.6, rng.uniform(0.5, 1.3), weak=0)
            across, down = frame[:, 0] * width, frame[:, 1] * height
            swell = float(np.clip(0.3 * width / max(float(foot[2]), 1e-3), 0.01, 0.12))
            self.relief(middle - (across + down) / 2, across, down, material, self.shape(*kind), swell)

    def tree(self, foot: Vector, height: float) -> None:
        rng = self.rng
        radius = height * rng.uniform(0.015, 0.04)
        trunk = height * rng.uniform(0.35, 0.7)
        self.pole(foot, trunk * 1.3, radius, 0.06, ("wood", "noise", "gravel"))
        crown = foot - [0, trunk, 0]
        if rng.random() < 0.3:  # bare
            for _ in range(3):
                frame = rotation(rng.normal(0, 0.7))
                material = self.material(("wood", "noise"), height, 0.5)
                middle = crown - np.array([0, height * 0.2, 0])
                self.card(middle, height * 0.7, height * 0.6, frame, material, self.shape("branches"))
        else:
            low = crown + np.array([0, height * 0.1, 0])
            self.bush(low, height * rng.uniform(0.5, 0.9), height - trunk, int(rng.integers(2, 5)))

    def plant(self, foot: Vector, size: float) -> None:
        """Long leaves that bend outwards from one foot, also towards and away from the cameras."""
        rng = self.rng
        material = self.material(("foliage", "noise", "plain", "leaves"), size * 0.5, weak=0.4)
        for _ in range(rng.integers(5, 22)):
            azimuth, rise = random_angle(rng), rng.uniform(0.2, 1.5)
            length = size * rng.uniform(0.4, 1.0)
            radius, start = length * rng.uniform(0.02, 0.06), foot
            leaf = material.lit(rng.uniform(0.6, 1.2))
            # A thick half, and one that ends in a tip.
            for taper in (-0.3, -0.95):
                frame = rotation(azimuth, rise)
                axis = -frame[:, 2]
                radius /= 1 - taper
                flat = (radius, radius * rng.uniform(0.4, 1), length / 4)
                self.quadric(start + axis * length / 4, -frame, flat, leaf, flat=0, taper=taper)
                start, radius = start + axis * length / 2, radius * (1 + taper)
                rise += rng.uniform(-0.5, 0.2)

    def tube(self, start: Vector, end: Vector, radius: float, material: Material) -> None:
        """An open cylinder between two points."""
        axis = end - start
        length = float(np.linalg.norm(axis))
        axis = axis / length
        side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        frame = np.stack([side, np.cross(axis, side), axis], 1)
        self.quadric((start + end) / 2, frame, (radius, radius, length / 2), material, flat=0)

    def machine(self, foot: Vector, size: float) -> None:
        """Wheels, tubes and solid parts, all over one another, as of a bicycle or an engine; one sees through it."""
        rng, frame = self.rng, rotation(self.rng.normal(0, 0.6))
        reach = np.array([rng.uniform(0.6, 2.0), 1.0, rng.uniform(0.05, 0.4)]) * size

        def point() -> Vector:
            return np.asarray(foot + frame @ (rng.uniform([-0.5, -1.0, -0.5], [0.5, 0.0, 0.5]) * reach))

        paints = [
            self.material(("plain", "plain", "noise", "gravel", "text"), size, weak=0.5, gloss=self.some_gloss(0.3))
            for _ in range(3)
        ]

        def paint() -> Material:
            return paints[int(rng.integers(3))].lit(rng.uniform(0.4, 1.3))

        for _ in range(rng.integers(0, 4)):
            side = size * rng.uniform(0.3, 0.8)
            hub = foot + frame @ (rng.uniform([-0.5, 0, -0.2], [0.5, 0, 0.2]) * reach) - np.array([0, side / 2, 0])
            self.card(hub, side, side, frame @ rotation(rng.normal(0, 0.2)), paint(), self.shape("wheel"))
        nodes = [point() for _ in range(rng.integers(3, 10))]
        for _ in range(rng.integers(4, 22)):
            start = nodes[int(rng.integers(len(nodes)))]
            self.tube(start, point(), size * log_uniform(rng, 0.008, 0.05), paint())
        for _ in range(rng.integers(1, 9)):
            sides = size * rng.uniform(0.05, 0.3, 3)
            if rng.random() < 0.5:
                self.quadric(point(), frame @ rotation(*rng.normal(0, 0.5, 3)), (sides / 1.5).tolist(), paint())
            else:
                self.box(point(), sides.tolist(), frame, ANY, size, 0.4, self.some_gloss(0.2))

    def slats(self, foot: Vector, size: float) -> None:
        """A chair, bench, crate, ladder or rack: legs, and one or two grids of slats."""
        rng, frame = self.rng, rotation(random_angle(self.rng))
        wide, deep, seat = size * rng.uniform(0.3, 1.8), size * rng.uniform(0.2, 0.6), size * rng.uniform(0.3, 0.6)
        wood = self.material(("wood", "wood", "plain", "noise", "fabric"), size, weak=0.3)
        thick = size * log_uniform(rng, 0.012, 0.05)
        across, up, depth = frame[:, 0], np.array([0, -1.0, 0]), frame[:, 2]
        for x, z in itertools.product((-wide / 2, wide / 2), (-deep / 2, deep / 2)):
            leg = foot + across * x + depth * z
            self.tube(leg, leg + up * (size if z > 0 else seat), thick, wood.lit(rng.uniform(0.6, 1.2)))

        def grid(corner: Vector, along: Vector, over: Vector, count: int, share: float) -> None:
            for k in range(count):
                start = corner + over * (k + rng.uniform(0, 0.1)) / count
                self.patch(start, along, over * share / count, wood.lit(rng.uniform(0.6, 1.25)))

        share = float(rng.uniform(0.15, 0.8))
        corner = foot - across * wide / 2 + depth * deep / 2
        back, count = up * (size - seat), int(rng.integers(2, 14))
        if rng.random() < 0.6:
            grid(corner + up * seat, back, across * wide, count, share)
            grid(corner + up * seat, across * wide, back, 1, 0.1)
            grid(corner + up * size, across * wide, back, 1, 0.1)
        else:
            grid(corner + up * seat * rng.choice([0.0, 1.0]), across * wide, back, count, share)
        if rng.random() < 0.7:
            grid(corner + up * seat, across * wide, -depth * deep, int(rng.integers(1, 8)), rng.uniform(0.5, 1.0))

    def shelf(self, foot: Vector, size: float) -> None:
        """Boards between uprights with things on them, open at the back or not."""
        rng, frame = self.rng, rotation(self.rng.normal(0, 0.5))
        wide, deep = size * rng.uniform(0.5, 2.0), size * rng.uniform(0.15, 0.4)
        wood = self.material(("wood", "plain", "noise"), size, weak=0.4)
        across, up, depth = frame[:, 0] * wide, np.array([0, -size, 0]), frame[:, 2] * deep
        corner, thick = foot - (across + depth) / 2, rng.uniform(0.01, 0.05)
        for x, z in itertools.product((0, 1), (0, 1)):
            post = corner + across * x + depth * z
            self.tube(post, post + up, thick * size, wood)
        if rng.random() < 0.4:
            self.patch(corner + depth, across, up, self.material(ANY, size, weak=0.5))
        boards = int(rng.integers(2, 6))
        for k in range(boards):
            board = corner + up * k / (boards - 0.8)
            self.patch(board, across, depth, wood.lit(0.7))
            self.patch(board, across, up * thick, wood.lit(rng.uniform(0.7, 1.2)))
            for along in np.arange(rng.uniform(0, 0.3), 0.9, rng.uniform(0.12, 0.4)):
                sides = size / boards * rng.uniform(0.2, 0.8, 3)
                place = board + across * (along + rng.uniform(0, 0.1)) + depth * rng.uniform(0.2, 0.8)
                if rng.random() < 0.6:
                    self.box(place, sides.tolist(), rotation(random_angle(rng)), ANY, size / 2, 0.2)
                else:
                    radii = (sides[0] / 3, sides[0] / 3, sides[1] / 2)
                    middle = place - np.array([0, sides[1] / 2, 0])
                    self.quadric(middle, rotation(0, np.pi / 2), radii, self.material(ANY, size / 2), flat=0)

    def person(self, foot: Vector, height: float) -> None:
        rng, upright = self.rng, rotation(random_angle(self.rng)) @ rotation(0, np.pi / 2)
        cloth = ("plain", "noise", "fabric", "stripes", "photo")
        for side in (-1, 1):
            leg = foot + np.array([side * 0.06, -0.24, rng.normal(0, 0.05)]) * height
            self.quadric(
                leg,
                rotation(0, np.pi / 2 + rng.normal(0, 0.15)),
                (height * 0.045, height * 0.05, height * 0.24),
                self.material(cloth, height * 0.4),
                0,
            )
        self.quadric(
            foot - [0, height * 0.66, 0],
            upright,
            (height * 0.13, height * 0.09, height * 0.22),
            self.material(cloth, height * 0.4),
        )
        self.quadric(
            foot - [0, height * 0.93, 0],
            upright,
            (height * 0.055, height * 0.065, height * 0.075),
            self.material(("plain", "noise"), height * 0.2),
        )

    def car(self, foot: Vector, yaw: float, unit: float) -> None:
        """A profile drawn out across, sides, windows and wheels; painted, hardly textured, mirroring."""
        rng, frame = self.rng, rotation(yaw)
        width, length = unit * rng.uniform(2.9, 3.6), unit * rng.uniform(6.5, 9)
        lift, height = unit * 0.35, unit * rng.choice([rng.uniform(2.1, 2.6), rng.uniform(2.6, 4.2)], p=[0.7, 0.3])
        up = np.array([0, -1.0, 0])
        variant = int(rng.integers(textures.VARIANTS))
        self.shadow(foot, width * 1.3, length * 1.1)
        paint = self.material(
            ("plain", "plain", "plain", "noise", "gravel"), unit * 8, weak=0.6, gloss=rng.uniform(0.05, 0.35)
        )
        glass = self.material(("plain", "leaves", "noise"), unit * 4, 0.5, weak=0.5, gloss=rng.uniform(0.3, 0.7))
        outline = [
            foot + frame[:, 2] * (along - 0.5) * length + up * (lift + tall * height)
            for along, tall in textures.car_profile(variant)
        ]
        for i, (a, b) in enumerate(itertools.pairwise(outline)):
            material = glass if i in (2, 5) else paint.lit(rng.uniform(0.6, 1.25))
            self.patch(a - frame[:, 0] * width / 2, frame[:, 0] * width, b - a, material)
        for side in (-0.5, 0.5):
            corner = foot + frame[:, 0] * side * width - frame[:, 2] * length / 2 + up * (lift + height)
            self.patch(corner, frame[:, 2] * length, -up * height, paint.lit(0.8 + side / 2), ("car", variant))
            outside = corner + frame[:, 0] * side * width * 4e-3
            self.patch(outside, frame[:, 2] * length, -up * height, glass, ("car glass", variant))
        side = -1.0 if frame[:, 0] @ foot > 0 else 1.0
        black = Material("gravel", int(rng.integers(textures.VARIANTS)), unit * 2, table=tone(rng, 0.35))
        for along in (-0.31, 0.31):
            hub = foot + frame[:, 0] * side * width * 0.505 + frame[:, 2] * along * length + up * unit * 0.6
            self.card(hub, unit * 1.2, unit * 1.2, frame @ rotation(np.pi / 2), black, ("ellipse", 0))

    def sign(self, foot: Vector, unit: float) -> None:
        rng = self.rng
        height, side = unit * rng.uniform(3.5, 6.5), unit * rng.uniform(0.8, 2)
        self.pole(foot, height, unit * rng.uniform(0.06, 0.14), 0.02, ("plain", "gravel"))
        cutout = (None, ("ellipse", 0), self.shape("polygon"))[int(rng.integers(3))]
        material = self.material(("poster", "text", "plain"), side * 1.5)
        self.card(
            foot - [0, height, 0.2 * unit],
            side,
            side * rng.uniform(0.6, 1.3),
            rotation(rng.normal(0, 0.4)),
            material,
            cutout,
        )

    def thing(self, center: Vector, size: float, upright: bool) -> None:
        """Any object of about this size; `center` is its middle, and it stands straight if `upright`."""
        rng = self.rng
        spin = rotation(random_angle(rng)) if upright else rotation(*rng.uniform(-np.pi, np.pi, 3))
        slant = rotation(rng.normal(0, 0.5), rng.normal(0, 0.4), rng.normal(0, 0.15 if upright else 1.5))
        foot = center + spin[:, 1] * size / 2
        gloss = self.some_gloss(0.15)
        aspect = float(rng.uniform(0.4, 1.6))
        kind = rng.choice(13, p=[0.17, 0.13, 0.1, 0.1, 0.06, 0.09, 0.05, 0.06, 0.03, 0.05, 0.07, 0.06, 0.03])
        if kind == 0:
            self.box(
                foot,
                (size * rng.uniform(0.3, 1.2), size, size * rng.uniform(0.2, 1.0)),
                spin,
                ANY,
                size,
                0.25,
                gloss,
                rng.random() < 0.5,
            )
        elif kind == 1:
            cutout = None if rng.random() < 0.4 else self.shape("polygon", "ellipse", "blob", "ring")
            opacity = float(rng.choice([1, 1, 1, 1, 1, 1, 0.3, 0.75]))
            self.card(
                center,
                size * aspect,
                size,
                slant,
                self.material(ANY, size, weak=0.15, gloss=gloss, opacity=opacity),
                cutout,
            )
        elif kind == 2:
            radii = (size / 2 * rng.uniform(0.5, 1.1, 3)).tolist()
            self.quadric(center, spin, radii, self.material(ANY, size, weak=0.25, gloss=gloss))
        elif kind == 3:  # cup, tin, flowerpot
            frame = rotation(0, -np.pi / 2) if upright else spin
            radius, taper = size * rng.uniform(0.15, 0.5), rng.uniform(-0.35, 0.35)
            self.quadric(
                center, frame, (radius, radius, size / 2), self.material(ANY, size, weak=0.3, gloss=gloss), 0, taper
            )
            if upright:
                top = 2 * radius * (1 - taper)  # the axis points down
                self.card(
                    center - [0, size / 2, 0],
                    top,
                    top,
                    rotation(0, np.pi / 2),
                    self.material(ANY, size, 0.5, weak=0.4),
                    ("ellipse", 0),
                )
        elif kind == 4:  # stick, pencil, broom
            frame = slant @ rotation(0, np.pi / 2)
            radius = size * rng.uniform(0.01, 0.05)
            self.quadric(
                center, frame, (radius, radius, size * rng.uniform(0.6, 1.2)), self.material(ANY, size, weak=0.4), 0
            )
        elif kind == 5:
            swell = float(np.clip(size / max(center[2], 1e-3) * rng.uniform(0.1, 0.35), 0.01, 0.13))
            self.cloth(
                center,
                size * aspect,
                size,
                slant,
                (*ANY, "fabric", "leaves", "noise"),
                ("blob", "polygon", "blob") if rng.random() < 0.8 else (),
                swell,
            )
        elif kind == 6:
            material = self.material(("foliage", "noise", "plain", "wood"), size)
            for _ in range(rng.integers(1, 4)):
                frame = rotation(rng.normal(0, 0.6), rng.normal(0, 0.3))
                self.card(center, size * aspect, size, frame, material, self.shape("fronds", "branches", "canopy"))
        elif kind == 7:
            self.card(
                center,
                size * aspect * 1.5,
                size,
                slant,
                self.material(ANY, size, weak=0.4),
                self.shape("fence", "wires", "ring"),
            )
        elif kind == 8:
            self.bush(foot, size, size, 3)
        elif kind == 9:
            self.plant(foot, size)
        elif kind == 10:
            self.machine(foot, size)
        elif kind == 11:
            self.slats(foot, size)
        else:
            self.shelf(foot, size)
