"""Random scenes: streets, rooms, open ground, and heaps of things in the air.

Object sizes follow a scene's `unit`, about 0.54 m (KITTI's baseline) in streets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from anynet.synthetic.objects import ANY, Scene, log_uniform, random_angle, rotation
from anynet.synthetic.surfaces import Camera, Material, Vector
from anynet.synthetic.textures import Rng


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
    """Road with curbs and markings, buildings or greenery along it, cars, people, poles, trees, sky."""
    camera = _camera(rng, height, width, (0.6, 1.2), (0.3, 0.55))
    scene = Scene(rng, camera, _tilt(rng, 0.012))
    camera_height = rng.uniform(2.2, 5.5)  # height above the road
    unit = camera_height / 3
    near, far = camera.focal / 150, camera.focal / rng.uniform(0.7, 2)
    _sky(scene)
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
    _ground(scene, camera_height, ("gravel", "gravel", "gravel", "plain", "bricks", "noise"), unit * 5, near, far)
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
                    scene.bush(
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
        scene.car(
            np.array([lane, camera_height, z]),
            float(rng.choice([0, np.pi]) + rng.normal(0, 0.08) if rng.random() < 0.75 else random_angle(rng)),
            unit,
        )
    for _ in range(rng.poisson(1.0)):
        z = camera.focal / rng.uniform(6, 60)
        scene.person(np.array([rng.uniform(-1, 1) * road, camera_height, z]), unit * rng.uniform(2.6, 3.6))
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
