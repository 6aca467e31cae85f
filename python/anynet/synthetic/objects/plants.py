"""Bushes, trees and leafy plants."""

from __future__ import annotations

import numpy as np

from anynet.synthetic.geometry import Vector, rotation
from anynet.synthetic.scene import Scene, random_angle


def bush(scene: Scene, foot: Vector, width: float, height: float, layers: int) -> None:
    """Layers of leaves with holes, each bulging, some way behind one another."""
    rng = scene.rng
    for layer in range(layers):
        frame = rotation(rng.normal(0, 0.4), rng.normal(0, 0.3), rng.uniform(0, 6.3) if layer else 0)
        middle = foot - [0, height / 2, 0] + rng.normal(0, 0.15, 3) * [width, height, width * 1.5]
        kind = ("blob", "canopy") if layer == 0 else ("canopy",)
        material = scene.material(("foliage",), height * 0.6, rng.uniform(0.5, 1.3), weak=0)
        across, down = frame[:, 0] * width, frame[:, 1] * height
        swell = float(np.clip(0.3 * width / max(float(foot[2]), 1e-3), 0.01, 0.12))
        scene.relief(middle - (across + down) / 2, across, down, material, scene.shape(*kind), swell)


def tree(scene: Scene, foot: Vector, height: float) -> None:
    rng = scene.rng
    radius = height * rng.uniform(0.015, 0.04)
    trunk = height * rng.uniform(0.35, 0.7)
    scene.pole(foot, trunk * 1.3, radius, 0.06, ("wood", "noise", "gravel"))
    crown = foot - [0, trunk, 0]
    if rng.random() < 0.3:  # bare
        for _ in range(3):
            frame = rotation(rng.normal(0, 0.7))
            material = scene.material(("wood", "noise"), height, 0.5)
            middle = crown - np.array([0, height * 0.2, 0])
            scene.card(middle, height * 0.7, height * 0.6, frame, material, scene.shape("branches"))
    else:
        low = crown + np.array([0, height * 0.1, 0])
        bush(scene, low, height * rng.uniform(0.5, 0.9), height - trunk, int(rng.integers(2, 5)))


def plant(scene: Scene, foot: Vector, size: float) -> None:
    """Long leaves that bend outwards from one foot, also towards and away from the cameras."""
    rng = scene.rng
    material = scene.material(("foliage", "noise", "plain", "leaves"), size * 0.5, weak=0.4)
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
            scene.quadric(start + axis * length / 4, -frame, flat, leaf, flat=0, taper=taper)
            start, radius = start + axis * length / 2, radius * (1 + taper)
            rise += rng.uniform(-0.5, 0.2)
