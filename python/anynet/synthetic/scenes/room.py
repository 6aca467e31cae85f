"""Rooms."""

from __future__ import annotations

import numpy as np

from anynet.synthetic import objects
from anynet.synthetic.geometry import rotation
from anynet.synthetic.materials import Material
from anynet.synthetic.scene import ANY, Scene, log_uniform
from anynet.synthetic.scenes.parts import add_backdrop, add_ground, random_camera, random_slant, random_tilt
from anynet.synthetic.textures import Rng


def room(rng: Rng, height: int, width: int) -> Scene:
    """Things on a table or in the air before a wall, one hiding the other, with large relative disparities."""
    camera = random_camera(rng, height, width, (0.9, 2.5), (0.15, 0.5))
    scene = Scene(rng, camera, random_tilt(rng, 0.06), weak=rng.choice([0.0, 0.5, 0.85], p=[0.4, 0.3, 0.3]))
    back = log_uniform(rng, 8, 50)  # disparity of the wall
    front = min(back * rng.uniform(1.6, 4.5), 150.0)
    z = camera.focal / back
    wide, tall = 3 * z * width / camera.focal, 4 * z * height / camera.focal
    frame = random_slant(rng)
    add_backdrop(scene, 1.4 * z)
    walls = (*ANY, "plain", "fabric", "poster")
    center = np.array([0, 0, z])
    if rng.random() < 0.25:
        scene.cloth(
            center,
            0.5 * wide,
            0.5 * tall,
            frame,
            ("fabric", "leaves", "photo", "noise", "poster"),
            (),
            rng.uniform(0.03, 0.12),
        )
        center = center * 1.15
    scene.card(center, wide, tall, frame, scene.material(walls, 0.7 * z * height / camera.focal, weak=0.3), None)
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
        spot = center + frame @ (
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
        spot = center + frame @ (
            np.array([rng.uniform(-0.15, 0.15) * wide, rng.uniform(-0.15, 0.15) * tall, -z * 2.5e-3])
        )
        dark = Material("plain", 0, table=np.zeros((256, 1, 3), np.uint8), opacity=rng.uniform(0.05, 0.35))
        wideness, tallness = tall * np.exp(rng.uniform(np.log(0.03), np.log(0.5), 2))
        scene.card(spot, wideness, tallness, frame, dark, scene.shape("soft"))
    table = None
    if rng.random() < 0.65:
        row = camera.cy + rng.uniform(0.15, 0.45) * height
        table = (row - camera.cy) / back
        add_ground(scene, table, ANY, 0.5 * z * height / camera.focal, camera.focal / 185, z * 1.02)
    while rng.random() < 0.4:  # something large that one sees through
        d = min(back * rng.uniform(1.3, 3.5), 150.0)
        size = height * rng.uniform(0.4, 1.1) / d
        spot = scene.at(rng.uniform(0.1, 0.9) * width, height * rng.uniform(0.7, 1.1), d)
        if table is not None:
            spot[1] = table
        (objects.machine, objects.slats, objects.shelf)[int(rng.choice(3, p=[0.5, 0.3, 0.2]))](scene, spot, size)
    count = int(rng.integers(6, 24))
    for _ in range(count):
        d = back * (front / back) ** rng.uniform(0.05, 1) if rng.random() < 0.7 else rng.uniform(back * 1.02, front)
        size = height * log_uniform(rng, 0.2, 1.3) / d * min(1.0, 0.6 + 0.4 * d / front)
        spot = scene.at(rng.uniform(-0.05, 1.05) * width, rng.uniform(0, 1) * height, d)
        if table is not None and rng.random() < 0.75:
            spot[1] = table - size / 2
            scene.shadow(np.array([spot[0], table - 1e-3, spot[2]]), size * 1.5, size)
            objects.thing(scene, spot, size, True)
        else:
            objects.thing(scene, spot, size, bool(rng.random() < 0.5))
    return scene
