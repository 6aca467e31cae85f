"""What the scenes share: cameras, and what lies behind and below everything."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anynet.synthetic.geometry import Camera, Vector, rotation
from anynet.synthetic.scene import ANY, Scene
from anynet.synthetic.textures import Rng


def random_tilt(rng: Rng, amount: float) -> Vector:
    return rotation(0, rng.normal(0, amount), rng.normal(0, amount / 2))


def random_camera(
    rng: Rng, height: int, width: int, focal: tuple[float, float], horizon: tuple[float, float]
) -> Camera:
    return Camera(
        width, height, width * rng.uniform(*focal), width * rng.uniform(0.4, 0.6), height * rng.uniform(*horizon)
    )


def random_slant(rng: Rng) -> Vector:
    return rotation(*np.clip(rng.normal(0, 0.22, 2), -0.4, 0.4))


def add_sky(scene: Scene) -> None:
    c = scene.camera
    z = c.focal / 0.05
    wide = np.array([3 * z * c.width / c.focal, 0, 0])
    tall = np.array([0, 4 * z * c.height / c.focal, 0])
    material = scene.material(("sky",), 6 * z * c.width / c.focal, scene.rng.uniform(0.8, 1.3), weak=0)
    scene.patch(np.array([0, 0, z]) - (wide + tall) / 2, wide, tall, material)


def add_backdrop(scene: Scene, z: float) -> None:
    """A wall square to the view at distance z, behind whatever else leaves gaps."""
    c = scene.camera
    wide, tall = np.array([3 * z * c.width / c.focal, 0, 0]), np.array([0, 4 * z * c.height / c.focal, 0])
    middle = np.array([0, 0, z])
    scene.patch(middle - (wide + tall) / 2, wide, tall, scene.material(ANY, z * c.height / c.focal, weak=0.3))


def add_ground(scene: Scene, y: float, kinds: Sequence[str], tile: float, near: float, far: float) -> None:
    reach = far * scene.camera.width / scene.camera.focal
    material = scene.material(kinds, tile, weak=0.3, gloss=scene.some_gloss(0.07))
    scene.patch(np.array([-reach, y, near]), np.array([2 * reach, 0, 0]), np.array([0, 0, far - near]), material)
