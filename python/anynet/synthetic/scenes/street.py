"""Streets."""

from __future__ import annotations

import numpy as np

from anynet.synthetic import objects
from anynet.synthetic.geometry import rotation
from anynet.synthetic.scene import ANY, Scene, log_uniform, random_angle
from anynet.synthetic.scenes.parts import add_ground, add_sky, random_camera, random_tilt
from anynet.synthetic.textures import Rng


def street(rng: Rng, height: int, width: int) -> Scene:
    """Road with curbs and markings, buildings or greenery along it, cars, people, poles, trees, sky."""
    camera = random_camera(rng, height, width, (0.6, 1.2), (0.3, 0.55))
    scene = Scene(rng, camera, random_tilt(rng, 0.012))
    camera_height = rng.uniform(2.2, 5.5)  # height above the road
    unit = camera_height / 3
    near, far = camera.focal / 150, camera.focal / rng.uniform(0.7, 2)
    add_sky(scene)
    if rng.random() < 0.8:  # what closes the view: hills, trees, houses
        z = camera.focal / rng.uniform(1, 8)
        wide, tall = 3 * z * width / camera.focal, rng.uniform(0.05, 0.45) * z * height / camera.focal
        cut = scene.shape("blob", "canopy") if rng.random() < 0.4 else None
        material = scene.material(("foliage", "facade", "leaves", "noise"), tall * 1.5, rng.uniform(0.5, 1.2))
        scene.patch(
            np.array([-wide / 2, camera_height - tall, z]),
            np.array([wide, 0, 0]),
            np.array([0, tall * 1.02, 0]),
            material,
            cut,
        )
    road = unit * rng.uniform(4, 13)  # half its width
    add_ground(scene, camera_height, ("gravel", "gravel", "gravel", "plain", "bricks", "noise"), unit * 5, near, far)
    for side in (-1, 1):
        curb = unit * rng.choice([0.0, 0.25, 0.4])
        inner, outer = side * road, side * far
        if rng.random() < 0.85:  # sidewalk or grass
            material = scene.material(("gravel", "bricks", "foliage", "noise", "plain"), unit * 3, weak=0.2)
            start = np.array([min(inner, outer), camera_height - curb - 1e-3, near])
            scene.patch(start, np.array([abs(outer - inner), 0, 0]), np.array([0, 0, far - near]), material)
            if curb:
                scene.patch(
                    np.array([inner, camera_height - curb, near]),
                    np.array([0, 0, far - near]),
                    np.array([0, curb, 0]),
                    scene.material(("gravel",), unit * 2),
                )
        foot_y = camera_height - curb
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
                    objects.bush(
                        scene,
                        np.array([wall + side * rng.uniform(0, 3) * unit, foot_y, z + k]),
                        unit * rng.uniform(4, 10),
                        unit * rng.uniform(3, 12),
                        1,
                    )
            z += length + unit * rng.choice([0.0, 0.0, rng.uniform(2, 30)])
        spot = near + unit * rng.uniform(2, 12)
        while spot < far * 0.3:  # along the curb
            place = np.array([side * (road + unit * rng.uniform(0.2, 2.5)), foot_y, spot])
            what = rng.choice(7, p=[0.28, 0.2, 0.14, 0.12, 0.1, 0.08, 0.08])
            if what == 0:
                scene.pole(place, unit * rng.uniform(1.5, 14), unit * rng.uniform(0.08, 0.35))
            elif what == 1:
                objects.tree(scene, place, unit * rng.uniform(6, 18))
            elif what == 2:
                objects.sign(scene, place, unit)
            elif what == 3:
                objects.person(scene, place, unit * rng.uniform(2.6, 3.6))
            elif what == 4:
                objects.bush(scene, place, unit * rng.uniform(2, 6), unit * rng.uniform(1.5, 5), 3)
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
                scene.box(place, sides, rotation(random_angle(rng)), ANY, unit * 3)
            spot += unit * rng.uniform(1.5, 9) + 0.12 * spot * rng.random()
    if rng.random() < 0.75:  # lane markings
        white = scene.material(("gravel",), unit, 1.6)
        for lane in np.arange(-road + unit * 0.5, road, road / rng.integers(1, 4)):
            dash, gap = unit * rng.uniform(3, 8), unit * rng.choice([0.01, rng.uniform(4, 12)])
            for z in np.arange(near, far * 0.3, dash + gap)[:12]:
                scene.patch(
                    np.array([lane, camera_height - 2e-3, z]),
                    np.array([unit * 0.25, 0, 0]),
                    np.array([0, 0, dash]),
                    white,
                )
    for _ in range(rng.integers(0, 5)):  # shadows of what stands beside the road
        scene.shadow(
            np.array([rng.uniform(-road, road), camera_height, rng.uniform(near, far * 0.2)]),
            unit * rng.uniform(3, 20),
            unit * rng.uniform(3, 20),
        )
    for _ in range(rng.integers(0, 9)):
        z = camera.focal / log_uniform(rng, 4, 70)
        lane = rng.uniform(-1, 1) * road
        objects.car(
            scene,
            np.array([lane, camera_height, z]),
            float(rng.choice([0, np.pi]) + rng.normal(0, 0.08) if rng.random() < 0.75 else random_angle(rng)),
            unit,
        )
    for _ in range(rng.poisson(1.0)):
        z = camera.focal / rng.uniform(6, 60)
        objects.person(scene, np.array([rng.uniform(-1, 1) * road, camera_height, z]), unit * rng.uniform(2.6, 3.6))
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
