"""Random scenes: streets, rooms, open ground, and heaps of things in the air.

Lengths are in baselines. The world is the left camera's frame turned by a small pitch and roll: y down, the ground
where a scene says. Object sizes follow a scene's `unit`, about 0.54 m (KITTI's baseline) in streets.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from anynet.render import textures
from anynet.render.surfaces import Camera, Material, Patch, Quadric, Relief, Surface, Vector
from anynet.render.textures import Image, Rng

MAX_DISPARITY = 192.0  # pixels
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
            glow=int(rng.integers(textures.VARIANTS)),
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
        centre: Vector,
        frame: Vector,
        radii: Sequence[float],
        material: Material,
        flat: int = 1,
        taper: float = 0.0,
    ) -> None:
        """`frame`: columns are the local axes; the third is a cylinder's or cone's own."""
        axes = (self.tilt @ frame / np.asarray(radii)).T
        light = np.array([self.rng.normal(0, 0.5), -0.8, -0.5])
        self.surfaces.append(Quadric(self.tilt @ centre, axes, material, flat, taper, light))

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
        centre = foot + y / 2
        kind = [self.pick(kinds)]
        shared = self.material(kind, tile, weak=weak, gloss=gloss)
        for normal, across, down in ((z, x, -y), (x, z, -y), (y, x, z)):
            for sign in (-1, 1):
                middle = centre + sign * normal / 2
                if sign * normal @ middle >= 0 and sign * normal @ (middle - np.array([1.0, 0, 0])) >= 0:
                    continue  # turned away from both eyes
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
        centre: Vector,
        width: float,
        height: float,
        frame: Vector,
        material: Material,
        cutout: tuple[str, int] | None,
    ) -> None:
        across, down = frame[:, 0] * width, frame[:, 1] * height
        self.patch(centre - (across + down) / 2, across, down, material, cutout)

    def cloth(
        self,
        centre: Vector,
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
        self.relief(centre - (across + down) / 2, across, down, self.material(kinds, width), cutout, swell)

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
            azimuth, rise = rng_angle(rng), rng.uniform(0.2, 1.5)
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
        rng, frame = self.rng, rotation(rng_angle(self.rng))
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
                    self.box(place, sides.tolist(), rotation(rng_angle(rng)), ANY, size / 2, 0.2)
                else:
                    radii = (sides[0] / 3, sides[0] / 3, sides[1] / 2)
                    middle = place - np.array([0, sides[1] / 2, 0])
                    self.quadric(middle, rotation(0, np.pi / 2), radii, self.material(ANY, size / 2), flat=0)

    def person(self, foot: Vector, height: float) -> None:
        rng, upright = self.rng, rotation(rng_angle(self.rng)) @ rotation(0, np.pi / 2)
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

    def thing(self, centre: Vector, size: float, upright: bool) -> None:
        """Any object of about this size; `centre` is its middle, and it stands straight if `upright`."""
        rng = self.rng
        spin = rotation(rng_angle(rng)) if upright else rotation(*rng.uniform(-np.pi, np.pi, 3))
        slant = rotation(rng.normal(0, 0.5), rng.normal(0, 0.4), rng.normal(0, 0.15 if upright else 1.5))
        foot = centre + spin[:, 1] * size / 2
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
                centre,
                size * aspect,
                size,
                slant,
                self.material(ANY, size, weak=0.15, gloss=gloss, opacity=opacity),
                cutout,
            )
        elif kind == 2:
            radii = (size / 2 * rng.uniform(0.5, 1.1, 3)).tolist()
            self.quadric(centre, spin, radii, self.material(ANY, size, weak=0.25, gloss=gloss))
        elif kind == 3:  # cup, tin, flowerpot
            frame = rotation(0, -np.pi / 2) if upright else spin
            radius, taper = size * rng.uniform(0.15, 0.5), rng.uniform(-0.35, 0.35)
            self.quadric(
                centre, frame, (radius, radius, size / 2), self.material(ANY, size, weak=0.3, gloss=gloss), 0, taper
            )
            if upright:
                top = 2 * radius * (1 - taper)  # the axis points down
                self.card(
                    centre - [0, size / 2, 0],
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
                centre, frame, (radius, radius, size * rng.uniform(0.6, 1.2)), self.material(ANY, size, weak=0.4), 0
            )
        elif kind == 5:
            swell = float(np.clip(size / max(centre[2], 1e-3) * rng.uniform(0.1, 0.35), 0.01, 0.13))
            self.cloth(
                centre,
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
                self.card(centre, size * aspect, size, frame, material, self.shape("fronds", "branches", "canopy"))
        elif kind == 7:
            self.card(
                centre,
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


def rng_angle(rng: Rng) -> float:
    return float(rng.uniform(-np.pi, np.pi))


def _tilt(rng: Rng, amount: float) -> Vector:
    return rotation(0, rng.normal(0, amount), rng.normal(0, amount / 2))


def _camera(rng: Rng, height: int, width: int, focal: tuple[float, float], horizon: tuple[float, float]) -> Camera:
    return Camera(
        width, height, width * rng.uniform(*focal), width * rng.uniform(0.4, 0.6), height * rng.uniform(*horizon)
    )


def _sky(scene: Scene) -> None:
    c = scene.camera
    z = c.focal / 0.05
    wide = np.array([3 * z * c.width / c.focal, 0, 0])
    tall = np.array([0, 4 * z * c.height / c.focal, 0])
    material = scene.material(("sky",), 6 * z * c.width / c.focal, scene.rng.uniform(0.8, 1.3), weak=0)
    scene.patch(np.array([0, 0, z]) - (wide + tall) / 2, wide, tall, material)


def _backdrop(scene: Scene, z: float) -> None:
    """A wall square to the view at distance z, behind whatever else leaves gaps."""
    c = scene.camera
    wide, tall = np.array([3 * z * c.width / c.focal, 0, 0]), np.array([0, 4 * z * c.height / c.focal, 0])
    middle = np.array([0, 0, z])
    scene.patch(middle - (wide + tall) / 2, wide, tall, scene.material(ANY, z * c.height / c.focal, weak=0.3))


def _slant(rng: Rng) -> Vector:
    return rotation(*np.clip(rng.normal(0, 0.22, 2), -0.4, 0.4))


def _ground(scene: Scene, y: float, kinds: Sequence[str], tile: float, near: float, far: float) -> None:
    reach = far * scene.camera.width / scene.camera.focal
    material = scene.material(kinds, tile, weak=0.3, gloss=scene.some_gloss(0.07))
    scene.patch(np.array([-reach, y, near]), np.array([2 * reach, 0, 0]), np.array([0, 0, far - near]), material)


def street(rng: Rng, height: int, width: int) -> Scene:
    """Road with kerbs and markings, buildings or greenery along it, cars, people, poles, trees, sky."""
    camera = _camera(rng, height, width, (0.6, 1.2), (0.3, 0.55))
    scene = Scene(rng, camera, _tilt(rng, 0.012))
    eye = rng.uniform(2.2, 5.5)  # height above the road
    unit = eye / 3
    near, far = camera.focal / 150, camera.focal / rng.uniform(0.7, 2)
    _sky(scene)
    if rng.random() < 0.8:  # what closes the view: hills, trees, houses
        z = camera.focal / rng.uniform(1, 8)
        wide, tall = 3 * z * width / camera.focal, rng.uniform(0.05, 0.45) * z * height / camera.focal
        cut = scene.shape("blob", "canopy") if rng.random() < 0.4 else None
        material = scene.material(("foliage", "facade", "leaves", "noise"), tall * 1.5, rng.uniform(0.5, 1.2))
        scene.patch(
            np.array([-wide / 2, eye - tall, z]), np.array([wide, 0, 0]), np.array([0, tall * 1.02, 0]), material, cut
        )
    road = unit * rng.uniform(4, 13)  # half its width
    _ground(scene, eye, ("gravel", "gravel", "gravel", "plain", "bricks", "noise"), unit * 5, near, far)
    for side in (-1, 1):
        kerb = unit * rng.choice([0.0, 0.25, 0.4])
        inner, outer = side * road, side * far
        if rng.random() < 0.85:  # pavement or grass
            material = scene.material(("gravel", "bricks", "foliage", "noise", "plain"), unit * 3, weak=0.2)
            start = np.array([min(inner, outer), eye - kerb - 1e-3, near])
            scene.patch(start, np.array([abs(outer - inner), 0, 0]), np.array([0, 0, far - near]), material)
            if kerb:
                scene.patch(
                    np.array([inner, eye - kerb, near]),
                    np.array([0, 0, far - near]),
                    np.array([0, kerb, 0]),
                    scene.material(("gravel",), unit * 2),
                )
        foot_y = eye - kerb
        wall = side * (road + unit * rng.uniform(1, 14))
        z = near + unit * rng.uniform(0, 30)
        style = rng.choice(3, p=[0.55, 0.3, 0.15])
        while z < far * 0.6:
            length = unit * rng.uniform(8, 45) + 0.2 * z
            deep = unit * rng.uniform(6, 25)
            place = np.array([wall + side * deep / 2, foot_y, z + length / 2])
            if style == 0 and rng.random() < 0.85:
                size = (deep, unit * rng.uniform(4, 35), length)
                scene.box(
                    place,
                    size,
                    rotation(rng.normal(0, 0.03)),
                    ("facade", "facade", "bricks", "gravel", "plain"),
                    unit * 14,
                    weak=0.1,
                )
            elif style == 1:
                if rng.random() < 0.5:
                    scene.box(
                        place,
                        (deep, unit * rng.uniform(2, 7), length),
                        rotation(0),
                        ("foliage", "leaves"),
                        unit * 5,
                        weak=0,
                    )
                for k in np.arange(0, length, unit * rng.uniform(5, 12)):
                    scene.bush(
                        np.array([wall + side * rng.uniform(0, 3) * unit, foot_y, z + k]),
                        unit * rng.uniform(4, 10),
                        unit * rng.uniform(3, 12),
                        1,
                    )
            z += length + unit * rng.choice([0.0, 0.0, rng.uniform(2, 30)])
        spot = near + unit * rng.uniform(2, 12)
        while spot < far * 0.3:  # along the kerb
            place = np.array([side * (road + unit * rng.uniform(0.2, 2.5)), foot_y, spot])
            what = rng.choice(7, p=[0.28, 0.2, 0.14, 0.12, 0.1, 0.08, 0.08])
            if what == 0:
                scene.pole(place, unit * rng.uniform(1.5, 14), unit * rng.uniform(0.08, 0.35))
            elif what == 1:
                scene.tree(place, unit * rng.uniform(6, 18))
            elif what == 2:
                scene.sign(place, unit)
            elif what == 3:
                scene.person(place, unit * rng.uniform(2.6, 3.6))
            elif what == 4:
                scene.bush(place, unit * rng.uniform(2, 6), unit * rng.uniform(1.5, 5), 3)
            elif what == 5:
                scene.card(
                    place - [0, unit, 0],
                    unit * rng.uniform(4, 12),
                    unit * 2,
                    rotation(np.pi / 2),
                    scene.material(ANY, unit * 3),
                    scene.shape("fence"),
                )
            else:
                sides = (unit * rng.uniform(0.8, 3, 3)).tolist()
                scene.box(place, sides, rotation(rng_angle(rng)), ANY, unit * 3)
            spot += unit * rng.uniform(1.5, 9) + 0.12 * spot * rng.random()
    if rng.random() < 0.75:  # lane markings
        white = scene.material(("gravel",), unit, 1.6)
        for lane in np.arange(-road + unit * 0.5, road, road / rng.integers(1, 4)):
            dash, gap = unit * rng.uniform(3, 8), unit * rng.choice([0.01, rng.uniform(4, 12)])
            for z in np.arange(near, far * 0.3, dash + gap)[:12]:
                scene.patch(
                    np.array([lane, eye - 2e-3, z]), np.array([unit * 0.25, 0, 0]), np.array([0, 0, dash]), white
                )
    for _ in range(rng.integers(0, 5)):  # shadows of what stands beside the road
        scene.shadow(
            np.array([rng.uniform(-road, road), eye, rng.uniform(near, far * 0.2)]),
            unit * rng.uniform(3, 20),
            unit * rng.uniform(3, 20),
        )
    for _ in range(rng.integers(0, 9)):
        z = camera.focal / log_uniform(rng, 4, 70)
        lane = rng.uniform(-1, 1) * road
        scene.car(
            np.array([lane, eye, z]),
            float(rng.choice([0, np.pi]) + rng.normal(0, 0.08) if rng.random() < 0.75 else rng_angle(rng)),
            unit,
        )
    for _ in range(rng.poisson(1.0)):
        z = camera.focal / rng.uniform(6, 60)
        scene.person(np.array([rng.uniform(-1, 1) * road, eye, z]), unit * rng.uniform(2.6, 3.6))
    if rng.random() < 0.15:  # overhead wires
        z = camera.focal / rng.uniform(8, 40)
        scene.card(
            np.array([0, -unit * rng.uniform(2, 8), z]),
            2 * z,
            z / 3,
            rotation(rng.normal(0, 0.4)),
            scene.material(("plain",), unit, 0.3),
            scene.shape("wires"),
        )
    return scene


def room(rng: Rng, height: int, width: int) -> Scene:
    """Things on a table or in the air before a wall, one hiding the other, with large relative disparities."""
    camera = _camera(rng, height, width, (0.9, 2.5), (0.15, 0.5))
    scene = Scene(rng, camera, _tilt(rng, 0.06), weak=rng.choice([0.0, 0.5, 0.85], p=[0.4, 0.3, 0.3]))
    back = log_uniform(rng, 8, 50)  # disparity of the wall
    front = min(back * rng.uniform(1.6, 4.5), 150.0)
    z = camera.focal / back
    wide, tall = 3 * z * width / camera.focal, 4 * z * height / camera.focal
    frame = _slant(rng)
    _backdrop(scene, 1.4 * z)
    walls = (*ANY, "plain", "fabric", "poster")
    centre = np.array([0, 0, z])
    if rng.random() < 0.25:
        scene.cloth(
            centre,
            0.5 * wide,
            0.5 * tall,
            frame,
            ("fabric", "leaves", "photo", "noise", "poster"),
            (),
            rng.uniform(0.03, 0.12),
        )
        centre = centre * 1.15
    scene.card(centre, wide, tall, frame, scene.material(walls, 0.7 * z * height / camera.focal, weak=0.3), None)
    if rng.random() < 0.35:  # a second wall, in a corner
        sign = rng.choice([-1, 1])
        corner = rotation(sign * rng.uniform(0.6, 1.4))
        reach = wide / 4 * rng.uniform(0.2, 0.9)
        scene.card(
            np.array([-sign * reach, 0, z - 0.15 * wide]),
            wide * 0.4,
            tall,
            corner,
            scene.material(walls, 0.5 * z * height / camera.focal, weak=0.3),
            None,
        )
    for _ in range(rng.integers(0, 5)):  # posters, windows, stains on the wall
        spot = centre + frame @ (
            np.array([rng.uniform(-0.12, 0.12) * wide, rng.uniform(-0.12, 0.12) * tall, -z * 2e-3])
        )
        side = tall * rng.uniform(0.02, 0.12)
        cutout = scene.shape("soft", "polygon", "ring") if rng.random() < 0.3 else None
        scene.card(
            spot,
            side * rng.uniform(0.5, 2),
            side,
            frame,
            scene.material(ANY, side, opacity=rng.choice([1, 1, 0.4])),
            cutout,
        )
    for _ in range(rng.integers(0, 6)):  # shadows and light falling off
        spot = centre + frame @ (
            np.array([rng.uniform(-0.15, 0.15) * wide, rng.uniform(-0.15, 0.15) * tall, -z * 2.5e-3])
        )
        dark = Material("plain", 0, table=np.zeros((256, 1, 3), np.uint8), opacity=rng.uniform(0.05, 0.35))
        wideness, tallness = tall * np.exp(rng.uniform(np.log(0.03), np.log(0.5), 2))
        scene.card(spot, wideness, tallness, frame, dark, scene.shape("soft"))
    table = None
    if rng.random() < 0.65:
        row = camera.cy + rng.uniform(0.15, 0.45) * height
        table = (row - camera.cy) / back
        _ground(scene, table, ANY, 0.5 * z * height / camera.focal, camera.focal / 185, z * 1.02)
    while rng.random() < 0.4:  # something large that one sees through
        d = min(back * rng.uniform(1.3, 3.5), 150.0)
        size = height * rng.uniform(0.4, 1.1) / d
        spot = scene.at(rng.uniform(0.1, 0.9) * width, height * rng.uniform(0.7, 1.1), d)
        if table is not None:
            spot[1] = table
        (scene.machine, scene.slats, scene.shelf)[int(rng.choice(3, p=[0.5, 0.3, 0.2]))](spot, size)
    count = int(rng.integers(6, 24))
    for _ in range(count):
        d = back * (front / back) ** rng.uniform(0.05, 1) if rng.random() < 0.7 else rng.uniform(back * 1.02, front)
        size = height * log_uniform(rng, 0.2, 1.3) / d * min(1.0, 0.6 + 0.4 * d / front)
        spot = scene.at(rng.uniform(-0.05, 1.05) * width, rng.uniform(0, 1) * height, d)
        if table is not None and rng.random() < 0.75:
            spot[1] = table - size / 2
            scene.shadow(np.array([spot[0], table - 1e-3, spot[2]]), size * 1.5, size)
            scene.thing(spot, size, True)
        else:
            scene.thing(spot, size, bool(rng.random() < 0.5))
    return scene


def ground(rng: Rng, height: int, width: int) -> Scene:
    """Open ground with frames, trees, stones and boxes: disparities to about 60."""
    camera = _camera(rng, height, width, (0.7, 1.4), (0.2, 0.55))
    scene = Scene(rng, camera, _tilt(rng, 0.06))
    back = log_uniform(rng, 1.0, 15)
    bottom = rng.uniform(15, 80)  # disparity at the lower border
    level = (height - camera.cy) / bottom
    z = camera.focal / back
    _sky(scene)
    wide, tall = 4 * z * width / camera.focal, z * height / camera.focal * rng.uniform(0.2, 1.5)
    kinds = ("foliage", "facade", "leaves", "bricks", "gravel", "photo", "plain", "noise")
    base = np.array([-wide / 2, level - tall, z])
    for k in range(rng.integers(1, 3)):
        cut = scene.shape("blob", "canopy") if k or rng.random() < 0.3 else None
        shift = np.array([rng.normal(0, 0.2) * wide, 0, -0.2 * z * k])
        turn = rotation(rng.normal(0, 0.3))[:, 0] * wide
        scene.patch(
            base + shift,
            turn,
            np.array([0, tall * 1.05, 0]),
            scene.material(kinds, tall * rng.uniform(0.3, 1), weak=0.2),
            cut,
        )
    near, floor = camera.focal / 185, ("gravel", "foliage", "noise", "bricks", "leaves", "photo", "wood")
    _ground(scene, level, floor, level * 1.5, near, z * 1.1)
    for _ in range(rng.integers(3, 22)):
        d = log_uniform(rng, back * 1.1, bottom)
        place = np.array([(rng.uniform(-0.05, 1.05) * width - camera.cx) / d, level, camera.focal / d])
        size = level * log_uniform(rng, 0.15, 2.5)
        scene.shadow(place, size, size)
        what = rng.random()
        if what < 0.2:
            scene.pole(place, size * 1.5, size * rng.uniform(0.01, 0.06), rng.choice([0.03, 0.5]))
        elif what < 0.32:
            scene.tree(place, size * 2)
        elif what < 0.42:
            scene.bush(place, size, size * 0.7, 3)
        elif what < 0.5:
            scene.person(place, level * rng.uniform(0.6, 1.1))
        else:
            scene.thing(place - [0, size / 2, 0], size, True)
    return scene


def things(rng: Rng, height: int, width: int) -> Scene:
    """Anything anywhere, at any angle, disparities to the limit."""
    camera = _camera(rng, height, width, (0.8, 2.0), (0.3, 0.7))
    scene = Scene(rng, camera, _tilt(rng, 0.12), weak=rng.choice([0.0, 0.6], p=[0.7, 0.3]))
    back = log_uniform(rng, 2, 45)
    front = back + (rng.choice([60.0, 110.0, 180.0]) - back) * rng.uniform(0.4, 1)
    z = camera.focal / back
    wide, tall = 3 * z * width / camera.focal, 4 * z * height / camera.focal
    frame = _slant(rng)
    _backdrop(scene, 1.6 * z)
    scene.card(
        np.array([0, 0, z]), wide, tall, frame, scene.material(ANY, 0.7 * z * height / camera.focal, weak=0.15), None
    )
    if rng.random() < 0.4:
        _ground(
            scene,
            (height - camera.cy) / rng.uniform(50, 150),
            ANY,
            0.5 * z * height / camera.focal,
            camera.focal / 185,
            z * 1.1,
        )
    for _ in range(rng.integers(8, 36)):
        d = back * (front / back) ** rng.uniform(0, 1)
        size = height * log_uniform(rng, 0.1, 0.9) / d
        scene.thing(scene.at(rng.uniform(-0.05, 1.05) * width, rng.uniform(-0.05, 1.05) * height, d), size, False)
    return scene


PRESETS: dict[str, Callable[[Rng, int, int], Scene]] = {
    "street": street,
    "room": room,
    "ground": ground,
    "things": things,
}
