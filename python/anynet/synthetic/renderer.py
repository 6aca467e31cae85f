"""Draws a scene for both cameras, with exact disparities and occlusions."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.samples import MAX_DISPARITY, RenderedSample
from anynet.synthetic.geometry import Window
from anynet.synthetic.scene import Scene
from anynet.synthetic.scenes import PRESETS
from anynet.synthetic.sensor import photograph
from anynet.synthetic.textures import Field, Image

MIXTURE = {"street": 0.35, "room": 0.4, "ground": 0.1, "things": 0.15}


def draw(scene: Scene, view: int) -> tuple[Image, Field]:
    """One view's image and disparity. Geometry from front to back, to find out what is hidden; color the other way."""
    camera = scene.camera
    shape = camera.height, camera.width
    solid = np.zeros(shape, np.float32)  # disparity of the nearest fully opaque surface
    fragments = []
    for surface in sorted(scene.surfaces, key=lambda s: s.depth):
        hull = surface.hull
        window = camera.window(hull, view)
        if window is None or camera.focal / hull[:, 2].min() < solid[window.slices].min():
            continue
        fragment = surface.cast(camera, view, window)
        if fragment is None:
            continue
        part = window.slices
        seen = cv2.bitwise_and(fragment.coverage, cv2.compare(fragment.disparity, solid[part], cv2.CMP_GE))
        left, top, wide, tall = cv2.boundingRect(seen)
        if wide:
            cv2.copyTo(fragment.disparity, cv2.inRange(seen, 255, 255), solid[part])
            x, y = left + window.left, top + window.top
            fragments.append((fragment, Window(x, y, x + wide, y + tall)))
    image, nearest = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32)
    for fragment, box in reversed(fragments):
        part = box.within(fragment.window)
        disparity, behind, target = fragment.disparity[part], nearest[box.slices], image[box.slices]
        front = cv2.compare(disparity, cv2.max(behind, solid[box.slices]), cv2.CMP_GE)
        cover = cv2.bitwise_and(fragment.coverage[part], front)
        color = fragment.paint(box)
        partial = cv2.inRange(cover, 1, 254)
        if cv2.hasNonZero(partial):
            share = cover.astype(np.float32) * np.float32(1 / 255)
            cv2.copyTo(cv2.blendLinear(color, target, share, 1 - share), partial, target)
        cv2.copyTo(color, cv2.inRange(cover, 255, 255), target)
        cv2.copyTo(disparity, cv2.inRange(cover, 128, 255), behind)
    return image, nearest


def occlusion(disparity: Field, other: Field, sign: int) -> NDArray[np.bool_]:
    """Pixels of one view that the other does not show.

    `sign`: -1 if `disparity` is the left view's (its match lies at x - d), +1 if it is the right view's.
    A pixel is seen if one of the two pixels around its match has its disparity to within one pixel.
    """
    height, width = disparity.shape
    match = np.arange(width, dtype=np.float32) + sign * disparity
    column = np.floor(match)
    row = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], disparity.shape)
    seen = np.zeros(disparity.shape, np.uint8)
    for step in (0, 1):
        there = cv2.remap(other, column + step, row, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        seen |= cv2.inRange(cv2.absdiff(there, disparity), 0, 1).astype(np.uint8, copy=False)
    return np.asarray((seen == 0) | (match < 0) | (match > width - 1))


def render(
    seed: int,
    height: int = 384,
    width: int = 768,
    preset: str | None = None,
    mixture: Mapping[str, float] = MIXTURE,
    sensor: bool = True,
) -> RenderedSample:
    """A random pair with exact ground truth; the same arguments give the same pair.

    preset: one of PRESETS; None draws one with the weights of `mixture`.
    sensor: False leaves out noise, blur and the differences between the cameras.
    Raises ValueError for an unknown preset or an image smaller than 64 x 64.
    """
    if height < 64 or width < 64:
        raise ValueError(f"render: expected at least 64 x 64 pixels, got {height} x {width}")
    unknown = set(mixture if preset is None else (preset,)) - set(PRESETS)
    if unknown:
        raise ValueError(f"render: unknown preset {sorted(unknown)}, expected some of {sorted(PRESETS)}")
    rng = np.random.default_rng(seed)
    if preset is None:
        weights = np.array(list(mixture.values()), float)
        preset = list(mixture)[int(rng.choice(len(weights), p=weights / weights.sum()))]
    scene = PRESETS[preset](rng, height, width)
    left, disparity = draw(scene, 0)
    right, right_disparity = draw(scene, 1)
    if sensor:
        left, right = photograph(rng, left, right)
    occluded = occlusion(disparity, right_disparity, -1)
    return RenderedSample(
        left=left,
        right=right,
        disparity=disparity,
        valid=disparity < MAX_DISPARITY,
        noc=~occluded,
        foreground=None,
        name=f"{preset}-{seed}",
        right_disparity=right_disparity,
        occluded=occluded,
        right_occluded=occlusion(right_disparity, disparity, 1),
    )
