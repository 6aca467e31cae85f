"""Any object."""

from __future__ import annotations

import numpy as np

from anynet.synthetic.geometry import Vector, rotation
from anynet.synthetic.objects.lattices import machine, shelf, slats
from anynet.synthetic.objects.plants import bush, plant
from anynet.synthetic.scene import ANY, Scene, random_angle


def thing(scene: Scene, center: Vector, size: float, upright: bool) -> None:
    """Any object of about this size; `center` is its middle, and it stands straight if `upright`."""
    rng = scene.rng
    spin = rotation(random_angle(rng)) if upright else rotation(*rng.uniform(-np.pi, np.pi, 3))
    slant = rotation(rng.normal(0, 0.5), rng.normal(0, 0.4), rng.normal(0, 0.15 if upright else 1.5))
    foot = center + spin[:, 1] * size / 2
    gloss = scene.some_gloss(0.15)
    aspect = float(rng.uniform(0.4, 1.6))
    kind = rng.choice(13, p=[0.17, 0.13, 0.1, 0.1, 0.06, 0.09, 0.05, 0.06, 0.03, 0.05, 0.07, 0.06, 0.03])
    if kind == 0:
        scene.box(
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
        cutout = None if rng.random() < 0.4 else scene.shape("polygon", "ellipse", "blob", "ring")
        opacity = float(rng.choice([1, 1, 1, 1, 1, 1, 0.3, 0.75]))
        scene.card(
            center,
            size * aspect,
            size,
            slant,
            scene.material(ANY, size, weak=0.15, gloss=gloss, opacity=opacity),
            cutout,
        )
    elif kind == 2:
        radii = (size / 2 * rng.uniform(0.5, 1.1, 3)).tolist()
        scene.quadric(center, spin, radii, scene.material(ANY, size, weak=0.25, gloss=gloss))
    elif kind == 3:  # cup, tin, flowerpot
        frame = rotation(0, -np.pi / 2) if upright else spin
        radius, taper = size * rng.uniform(0.15, 0.5), rng.uniform(-0.35, 0.35)
        scene.quadric(
            center, frame, (radius, radius, size / 2), scene.material(ANY, size, weak=0.3, gloss=gloss), 0, taper
        )
        if upright:
            top = 2 * radius * (1 - taper)  # the axis points down
            scene.card(
                center - [0, size / 2, 0],
                top,
                top,
                rotation(0, np.pi / 2),
                scene.material(ANY, size, 0.5, weak=0.4),
                ("ellipse", 0),
            )
    elif kind == 4:  # stick, pencil, broom
        frame = slant @ rotation(0, np.pi / 2)
        radius = size * rng.uniform(0.01, 0.05)
        scene.quadric(
            center, frame, (radius, radius, size * rng.uniform(0.6, 1.2)), scene.material(ANY, size, weak=0.4), 0
        )
    elif kind == 5:
        swell = float(np.clip(size / max(center[2], 1e-3) * rng.uniform(0.1, 0.35), 0.01, 0.13))
        scene.cloth(
            center,
            size * aspect,
            size,
            slant,
            (*ANY, "fabric", "leaves", "noise"),
            ("blob", "polygon", "blob") if rng.random() < 0.8 else (),
            swell,
        )
    elif kind == 6:
        material = scene.material(("foliage", "noise", "plain", "wood"), size)
        for _ in range(rng.integers(1, 4)):
            frame = rotation(rng.normal(0, 0.6), rng.normal(0, 0.3))
            scene.card(center, size * aspect, size, frame, material, scene.shape("fronds", "branches", "canopy"))
    elif kind == 7:
        scene.card(
            center,
            size * aspect * 1.5,
            size,
            slant,
            scene.material(ANY, size, weak=0.4),
            scene.shape("fence", "wires", "ring"),
        )
    elif kind == 8:
        bush(scene, foot, size, size, 3)
    elif kind == 9:
        plant(scene, foot, size)
    elif kind == 10:
        machine(scene, foot, size)
    elif kind == 11:
        slats(scene, foot, size)
    else:
        shelf(scene, foot, size)
