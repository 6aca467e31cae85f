"""Objects that one sees through: machines, slatted furniture and shelves."""

from __future__ import annotations

import itertools

import numpy as np

from anynet.synthetic.geometry import Vector, rotation
from anynet.synthetic.materials import Material
from anynet.synthetic.scene import ANY, Scene, log_uniform, random_angle


def machine(scene: Scene, foot: Vector, size: float) -> None:
    """Wheels, tubes and solid parts, all over one another, as of a bicycle or an engine; one sees through it."""
    rng, frame = scene.rng, rotation(scene.rng.normal(0, 0.6))
    reach = np.array([rng.uniform(0.6, 2.0), 1.0, rng.uniform(0.05, 0.4)]) * size

    def point() -> Vector:
        return np.asarray(foot + frame @ (rng.uniform([-0.5, -1.0, -0.5], [0.5, 0.0, 0.5]) * reach))

    paints = [
        scene.material(("plain", "plain", "noise", "gravel", "text"), size, weak=0.5, gloss=scene.some_gloss(0.3))
        for _ in range(3)
    ]

    def paint() -> Material:
        return paints[int(rng.integers(3))].lit(rng.uniform(0.4, 1.3))

    for _ in range(rng.integers(0, 4)):
        side = size * rng.uniform(0.3, 0.8)
        hub = foot + frame @ (rng.uniform([-0.5, 0, -0.2], [0.5, 0, 0.2]) * reach) - np.array([0, side / 2, 0])
        scene.card(hub, side, side, frame @ rotation(rng.normal(0, 0.2)), paint(), scene.shape("wheel"))
    nodes = [point() for _ in range(rng.integers(3, 10))]
    for _ in range(rng.integers(4, 22)):
        start = nodes[int(rng.integers(len(nodes)))]
        scene.tube(start, point(), size * log_uniform(rng, 0.008, 0.05), paint())
    for _ in range(rng.integers(1, 9)):
        sides = size * rng.uniform(0.05, 0.3, 3)
        if rng.random() < 0.5:
            scene.quadric(point(), frame @ rotation(*rng.normal(0, 0.5, 3)), (sides / 1.5).tolist(), paint())
        else:
            scene.box(point(), sides.tolist(), frame, ANY, size, 0.4, scene.some_gloss(0.2))


def slats(scene: Scene, foot: Vector, size: float) -> None:
    """A chair, bench, crate, ladder or rack: legs, and one or two grids of slats."""
    rng, frame = scene.rng, rotation(random_angle(scene.rng))
    wide, deep, seat = size * rng.uniform(0.3, 1.8), size * rng.uniform(0.2, 0.6), size * rng.uniform(0.3, 0.6)
    wood = scene.material(("wood", "wood", "plain", "noise", "fabric"), size, weak=0.3)
    thick = size * log_uniform(rng, 0.012, 0.05)
    across, up, depth = frame[:, 0], np.array([0, -1.0, 0]), frame[:, 2]
    for x, z in itertools.product((-wide / 2, wide / 2), (-deep / 2, deep / 2)):
        leg = foot + across * x + depth * z
        scene.tube(leg, leg + up * (size if z > 0 else seat), thick, wood.lit(rng.uniform(0.6, 1.2)))

    def grid(corner: Vector, along: Vector, over: Vector, count: int, share: float) -> None:
        for k in range(count):
            start = corner + over * (k + rng.uniform(0, 0.1)) / count
            scene.patch(start, along, over * share / count, wood.lit(rng.uniform(0.6, 1.25)))

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


def shelf(scene: Scene, foot: Vector, size: float) -> None:
    """Boards between uprights with things on them, open at the back or not."""
    rng, frame = scene.rng, rotation(scene.rng.normal(0, 0.5))
    wide, deep = size * rng.uniform(0.5, 2.0), size * rng.uniform(0.15, 0.4)
    wood = scene.material(("wood", "plain", "noise"), size, weak=0.4)
    across, up, depth = frame[:, 0] * wide, np.array([0, -size, 0]), frame[:, 2] * deep
    corner, thick = foot - (across + depth) / 2, rng.uniform(0.01, 0.05)
    for x, z in itertools.product((0, 1), (0, 1)):
        post = corner + across * x + depth * z
        scene.tube(post, post + up, thick * size, wood)
    if rng.random() < 0.4:
        scene.patch(corner + depth, across, up, scene.material(ANY, size, weak=0.5))
    boards = int(rng.integers(2, 6))
    for k in range(boards):
        board = corner + up * k / (boards - 0.8)
        scene.patch(board, across, depth, wood.lit(0.7))
        scene.patch(board, across, up * thick, wood.lit(rng.uniform(0.7, 1.2)))
        for along in np.arange(rng.uniform(0, 0.3), 0.9, rng.uniform(0.12, 0.4)):
            sides = size / boards * rng.uniform(0.2, 0.8, 3)
            place = board + across * (along + rng.uniform(0, 0.1)) + depth * rng.uniform(0.2, 0.8)
            if rng.random() < 0.6:
                scene.box(place, sides.tolist(), rotation(random_angle(rng)), ANY, size / 2, 0.2)
            else:
                radii = (sides[0] / 3, sides[0] / 3, sides[1] / 2)
                middle = place - np.array([0, sides[1] / 2, 0])
                scene.quadric(middle, rotation(0, np.pi / 2), radii, scene.material(ANY, size / 2), flat=0)
