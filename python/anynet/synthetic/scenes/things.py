"""Heaps of things in the air."""

from __future__ import annotations

import numpy as np

from anynet.synthetic import objects
from anynet.synthetic.scene import ANY, Scene, log_uniform
from anynet.synthetic.scenes.parts import add_backdrop, add_ground, random_camera, random_slant, random_tilt
from anynet.synthetic.textures import Rng


def things(rng: Rng, height: int, width: int) -> Scene:
    """Anything anywhere, at any angle, disparities to the limit."""
    camera = random_camera(rng, height, width, (0.8, 2.0), (0.3, 0.7))
    scene = Scene(rng, camera, random_tilt(rng, 0.12), weak=rng.choice([0.0, 0.6], p=[0.7, 0.3]))
    back = log_uniform(rng, 2, 45)
    front = back + (rng.choice([60.0, 110.0, 180.0]) - back) * rng.uniform(0.4, 1)
    z = camera.focal / back
    wide, tall = 3 * z * width / camera.focal, 4 * z * height / camera.focal
    frame = random_slant(rng)
    add_backdrop(scene, 1.6 * z)
    scene.card(
        np.array([0, 0, z]), wide, tall, frame, scene.material(ANY, 0.7 * z * height / camera.focal, weak=0.15), None
    )
    if rng.random() < 0.4:
        add_ground(
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
        objects.thing(
            scene, scene.at(rng.uniform(-0.05, 1.05) * width, rng.uniform(-0.05, 1.05) * height, d), size, False
        )
    return scene
