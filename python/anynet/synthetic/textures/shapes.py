"""Cut-out shapes, uint8 [SHAPE_SIZE, SHAPE_SIZE], 255 inside, by kind."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.synthetic.textures.fields import Field, Image, Rng, octaves

SHAPE_SIZE = 256  # texels along a side


def _ellipse(rng: Rng) -> Image:
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    center = SHAPE_SIZE // 2
    cv2.circle(mask, (center, center), center - 3, 255, -1, cv2.LINE_AA)
    return mask


def _polygon(rng: Rng) -> Image:
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    corners = rng.integers(3, 10)
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False) + rng.uniform(0, 2 * np.pi / corners, corners)
    radius = rng.uniform(0.4, 1, corners) * (SHAPE_SIZE / 2 - 3)
    points = SHAPE_SIZE / 2 + radius[:, None] * np.stack([np.cos(angles), np.sin(angles)], 1)
    cv2.fillPoly(mask, [np.round(points).astype(np.int32)], 255, cv2.LINE_AA)
    return mask


def _falloff(power: float = 2) -> Field:
    """1 in the middle, 0 on the border of a shape."""
    axis = np.abs(np.linspace(-1, 1, SHAPE_SIZE, dtype=np.float32)) ** power
    return np.asarray(np.clip(1 - axis[:, None] - axis, 0, 1))


def _threshold(field: Field, softness: float = 12) -> Image:
    return np.asarray(np.clip(127 + field * 255 * softness, 0, 255), np.uint8)


def _blob(rng: Rng) -> Image:
    return _threshold(octaves(rng, SHAPE_SIZE, rng.uniform(0.2, 0.55)) + _falloff() - 1.0)


def _canopy(rng: Rng) -> Image:
    """Leaves with holes between them."""
    fine = octaves(rng, SHAPE_SIZE, 0.9, first=int(rng.integers(2, 5)))
    coarse = octaves(rng, SHAPE_SIZE, 0.5)
    return _threshold(0.6 * fine + 0.6 * coarse + 0.9 * _falloff() - rng.uniform(0.9, 1.15), 8)


def _soft(rng: Rng) -> Image:
    """Soft-edged blob for shadows and highlights."""
    field = _falloff() * (0.9 + 1.2 * octaves(rng, SHAPE_SIZE, 0.4))
    return np.asarray(255 * np.clip(field, 0, 1), np.uint8)


def _fence(rng: Rng) -> Image:
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    step, thick = int(rng.integers(12, 64)), int(rng.integers(2, 9))
    kind = rng.integers(3)
    if kind == 0:  # wire mesh
        for k in range(-SHAPE_SIZE, 2 * SHAPE_SIZE, step):
            cv2.line(mask, (k, 0), (k + SHAPE_SIZE, SHAPE_SIZE), 255, thick, cv2.LINE_AA)
            cv2.line(mask, (k, SHAPE_SIZE), (k + SHAPE_SIZE, 0), 255, thick, cv2.LINE_AA)
    else:  # posts, with few or many rails
        for x in range(step // 2, SHAPE_SIZE, step):
            cv2.rectangle(mask, (x, 0), (x + thick, SHAPE_SIZE), 255, -1)
        for y in range(10, SHAPE_SIZE, step if kind == 1 else 110):
            cv2.rectangle(mask, (0, y), (SHAPE_SIZE, y + thick), 255, -1)
    return mask


def _branches(rng: Rng) -> Image:
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    stack = [(np.array([SHAPE_SIZE / 2, SHAPE_SIZE]), -np.pi / 2, SHAPE_SIZE * 0.3, rng.uniform(4, 14))]
    while stack:
        start, angle, length, width = stack.pop()
        end = start + length * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(
            mask,
            np.round(start).astype(int).tolist(),
            np.round(end).astype(int).tolist(),
            255,
            max(1, round(width)),
            cv2.LINE_AA,
        )
        if length > 14:
            for _ in range(rng.integers(2, 4)):
                stack.append((end, angle + rng.normal(0, 0.55), length * rng.uniform(0.55, 0.85), width * 0.65))
    return mask


def _fronds(rng: Rng) -> Image:
    """Long pointed leaves from one root, as of an aloe."""
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    root = np.array([SHAPE_SIZE / 2, SHAPE_SIZE * 0.95])
    for _ in range(rng.integers(4, 14)):
        angle, bend = rng.uniform(-np.pi, 0), rng.normal(0, 0.6)
        length, width = SHAPE_SIZE * rng.uniform(0.35, 0.9), rng.uniform(4, 14)
        t = np.linspace(0, 1, 12)
        direction = angle + bend * t
        spine = root + length / 12 * np.cumsum(np.stack([np.cos(direction), np.sin(direction)], 1), 0)
        side = np.stack([-np.sin(direction), np.cos(direction)], 1) * (width * (1 - t) ** 0.7)[:, None]
        outline = np.concatenate([spine + side, (spine - side)[::-1]])
        cv2.fillPoly(mask, [np.round(outline).astype(np.int32)], 255, cv2.LINE_AA)
    return mask


def _wires(rng: Rng) -> Image:
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    t = np.linspace(0, 1, 40)
    for _ in range(rng.integers(1, 6)):
        y = rng.uniform(20, SHAPE_SIZE - 20) + rng.uniform(-60, 60) * t + rng.uniform(0, 120) * (t - 0.5) ** 2
        points = np.round(np.stack([t * SHAPE_SIZE, y], 1)).astype(np.int32)
        cv2.polylines(mask, [points], False, 255, int(rng.integers(1, 5)), cv2.LINE_AA)
    return mask


def _ring(rng: Rng) -> Image:
    mask = _ellipse(rng)
    center = SHAPE_SIZE // 2
    cv2.circle(mask, (center, center), int(rng.uniform(0.5, 0.92) * center), 0, -1, cv2.LINE_AA)
    for angle in rng.uniform(0, np.pi, rng.choice([0, 2, 8])):  # spokes
        arm = 0.9 * center * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(mask, (center - arm).astype(int).tolist(), (center + arm).astype(int).tolist(), 255, 2, cv2.LINE_AA)
    return mask


def _wheel(rng: Rng) -> Image:
    """A rim with a tire, spokes or arms, and a hub."""
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    center = SHAPE_SIZE // 2
    rim = int(rng.uniform(0.06, 0.35) * center)
    cv2.circle(mask, (center, center), center - 3 - rim // 2, 255, rim, cv2.LINE_AA)
    cv2.circle(mask, (center, center), int(rng.uniform(0.05, 0.4) * center), 255, -1, cv2.LINE_AA)
    count = int(rng.integers(3, 15))
    width = max(2, int(rng.uniform(0.05, 0.9) * center / count))
    start, lean = rng.uniform(0, 2 * np.pi), rng.normal(0, 0.4)
    for angle in start + np.linspace(0, 2 * np.pi, count, endpoint=False):
        ends = [
            np.round(center + r * (center - rim) * np.array([np.cos(angle + t), np.sin(angle + t)]))
            .astype(int)
            .tolist()
            for r, t in ((0, 0), (0.6, 0), (1, lean))
        ]
        for a, b in itertools.pairwise(ends):
            cv2.line(mask, a, b, 255, width, cv2.LINE_AA)
    return mask


def car_profile(variant: int) -> NDArray[np.float64]:
    """Outline of a car's side from bumper to bumper over the roof: [9, 2] of (along, height) in 0..1."""
    rng = np.random.default_rng([300, variant])
    belt = rng.uniform(0.5, 0.65)
    hood, pillar = rng.uniform(0.05, 0.3), rng.uniform(0.06, 0.16)
    rear, slope = rng.uniform(0.8, 0.99), rng.uniform(0.01, 0.16)
    nose, tail = belt * rng.uniform(0.75, 0.95), belt * rng.uniform(0.9, 1.1)
    return np.array([
        (0, 0), (0, nose), (hood, belt), (hood + pillar, 1), (0.5 * (hood + pillar + rear), 1.0),
        (rear - slope, 0.98), (rear, tail), (1, tail * 0.97), (1, 0),
    ])  # fmt: skip


def car(variant: int, glass: bool) -> Image:
    points = car_profile(variant)
    if glass:  # the part above the belt, shrunk
        points = points[2:7]
        points = points.mean(0) + 0.8 * (points - points.mean(0))
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    pixels = np.stack([points[:, 0], 1 - points[:, 1]], 1) * (SHAPE_SIZE - 1)
    cv2.fillPoly(mask, [np.round(pixels).astype(np.int32)], 255, cv2.LINE_AA)
    return mask


SHAPES: dict[str, Callable[[Rng], Image]] = {
    "ellipse": _ellipse, "polygon": _polygon, "blob": _blob, "canopy": _canopy, "soft": _soft, "fence": _fence,
    "branches": _branches, "fronds": _fronds, "wires": _wires, "ring": _ring,
    "wheel": _wheel,
}  # fmt: skip
