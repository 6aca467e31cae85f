"""What stands in streets: people, cars and signs."""

from __future__ import annotations

import itertools

import numpy as np

from anynet.synthetic import textures
from anynet.synthetic.geometry import Vector, rotation
from anynet.synthetic.materials import Material
from anynet.synthetic.scene import Scene, random_angle, tone


def person(scene: Scene, foot: Vector, height: float) -> None:
    rng, upright = scene.rng, rotation(random_angle(scene.rng)) @ rotation(0, np.pi / 2)
    cloth = ("plain", "noise", "fabric", "stripes", "photo")
    for side in (-1, 1):
        leg = foot + np.array([side * 0.06, -0.24, rng.normal(0, 0.05)]) * height
        scene.quadric(
            leg,
            rotation(0, np.pi / 2 + rng.normal(0, 0.15)),
            (height * 0.045, height * 0.05, height * 0.24),
            scene.material(cloth, height * 0.4),
            0,
        )
    scene.quadric(
        foot - [0, height * 0.66, 0],
        upright,
        (height * 0.13, height * 0.09, height * 0.22),
        scene.material(cloth, height * 0.4),
    )
    scene.quadric(
        foot - [0, height * 0.93, 0],
        upright,
        (height * 0.055, height * 0.065, height * 0.075),
        scene.material(("plain", "noise"), height * 0.2),
    )


def car(scene: Scene, foot: Vector, yaw: float, unit: float) -> None:
    """A profile drawn out across, sides, windows and wheels; painted, hardly textured, mirroring."""
    rng, frame = scene.rng, rotation(yaw)
    width, length = unit * rng.uniform(2.9, 3.6), unit * rng.uniform(6.5, 9)
    lift, height = unit * 0.35, unit * rng.choice([rng.uniform(2.1, 2.6), rng.uniform(2.6, 4.2)], p=[0.7, 0.3])
    up = np.array([0, -1.0, 0])
    variant = int(rng.integers(textures.VARIANTS))
    scene.shadow(foot, width * 1.3, length * 1.1)
    paint = scene.material(
        ("plain", "plain", "plain", "noise", "gravel"), unit * 8, weak=0.6, gloss=rng.uniform(0.05, 0.35)
    )
    glass = scene.material(("plain", "leaves", "noise"), unit * 4, 0.5, weak=0.5, gloss=rng.uniform(0.3, 0.7))
    outline = [
        foot + frame[:, 2] * (along - 0.5) * length + up * (lift + tall * height)
        for along, tall in textures.car_profile(variant)
    ]
    for i, (a, b) in enumerate(itertools.pairwise(outline)):
        material = glass if i in (2, 5) else paint.lit(rng.uniform(0.6, 1.25))
        scene.patch(a - frame[:, 0] * width / 2, frame[:, 0] * width, b - a, material)
    for side in (-0.5, 0.5):
        corner = foot + frame[:, 0] * side * width - frame[:, 2] * length / 2 + up * (lift + height)
        scene.patch(corner, frame[:, 2] * length, -up * height, paint.lit(0.8 + side / 2), ("car", variant))
        outside = corner + frame[:, 0] * side * width * 4e-3
        scene.patch(outside, frame[:, 2] * length, -up * height, glass, ("car glass", variant))
    side = -1.0 if frame[:, 0] @ foot > 0 else 1.0
    black = Material("gravel", int(rng.integers(textures.VARIANTS)), unit * 2, table=tone(rng, 0.35))
    for along in (-0.31, 0.31):
        hub = foot + frame[:, 0] * side * width * 0.505 + frame[:, 2] * along * length + up * unit * 0.6
        scene.card(hub, unit * 1.2, unit * 1.2, frame @ rotation(np.pi / 2), black, ("ellipse", 0))


def sign(scene: Scene, foot: Vector, unit: float) -> None:
    rng = scene.rng
    height, side = unit * rng.uniform(3.5, 6.5), unit * rng.uniform(0.8, 2)
    scene.pole(foot, height, unit * rng.uniform(0.06, 0.14), 0.02, ("plain", "gravel"))
    cutout = (None, ("ellipse", 0), scene.shape("polygon"))[int(rng.integers(3))]
    material = scene.material(("poster", "text", "plain"), side * 1.5)
    scene.card(
        foot - [0, height, 0.2 * unit],
        side,
        side * rng.uniform(0.6, 1.3),
        rotation(rng.normal(0, 0.4)),
        material,
        cutout,
    )
