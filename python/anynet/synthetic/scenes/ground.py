"""Open ground."""

from __future__ import annotations

import numpy as np

from anynet.synthetic import objects
from anynet.synthetic.geometry import rotation
from anynet.synthetic.scene import Scene, log_uniform
from anynet.synthetic.scenes.parts import add_ground, add_sky, random_camera, random_tilt
from anynet.synthetic.textures import Rng


def ground(rng: Rng, height: int, width: int) -> Scene:
    """Open ground with frames, trees, stones and boxes: disparities to about 60."""
    camera = random_camera(rng, height, width, (0.7, 1.4), (0.2, 0.55))
    scene = Scene(rng, camera, random_tilt(rng, 0.06))
    back = log_uniform(rng, 1.0, 15)
    bottom = rng.uniform(15, 80)  # disparity at the lower border
    level = (height - camera.cy) / bottom
    z = camera.focal / back
    add_sky(scene)
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
    add_ground(scene, level, floor, level * 1.5, near, z * 1.1)
    for _ in range(rng.integers(3, 22)):
        d = log_uniform(rng, back * 1.1, bottom)
        place = np.array([(rng.uniform(-0.05, 1.05) * width - camera.cx) / d, level, camera.focal / d])
        size = level * log_uniform(rng, 0.15, 2.5)
        scene.shadow(place, size, size)
        what = rng.random()
        if what < 0.2:
            scene.pole(place, size * 1.5, size * rng.uniform(0.01, 0.06), rng.choice([0.03, 0.5]))
        elif what < 0.32:
            objects.tree(scene, place, size * 2)
        elif what < 0.42:
            objects.bush(scene, place, size, size * 0.7, 3)
        elif what < 0.5:
            objects.person(scene, place, level * rng.uniform(0.6, 1.1))
        else:
            objects.thing(scene, place - [0, size / 2, 0], size, True)
    return scene
