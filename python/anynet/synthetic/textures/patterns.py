"""Textures, uint8 RGB [SIZE, SIZE, 3], by kind.

All are procedural but `photo`, which crops the public-domain and CC0 pictures that scikit-image carries (astronaut,
brick, camera, chelsea, coffee, grass, gravel, hubble_deep_field, retina, rocket).
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import cv2
import numpy as np
import skimage.data
from numpy.typing import NDArray

from anynet.synthetic.textures.fields import Image, Rng, color, modulate, octaves, palette, ramp

SIZE = 384  # texels along a side
PHOTOS = (  # see the licenses above
    "astronaut", "brick", "camera", "chelsea", "coffee", "grass", "gravel", "hubble_deep_field", "retina", "rocket",
)  # fmt: skip


def _scatter(rng: Rng, canvas: Image, count: int, radii: tuple[float, float], colors: NDArray[np.float64]) -> None:
    """Dead leaves: overlapping shapes with power-law sizes, whose statistics are close to those of photographs."""
    size = canvas.shape[0]
    low, high = radii
    # Inverse-cubic density of radii, the scale-invariant choice.
    radius = 1 / np.sqrt(rng.uniform(1 / high**2, 1 / low**2, count))
    center = rng.uniform(0, size, (count, 2))
    for r, c, tint in zip(radius, center, colors[rng.integers(len(colors), size=count)], strict=True):
        fill = tuple(float(t) for t in np.clip(tint + rng.normal(0, 12), 0, 255))
        kind = rng.integers(3)
        if kind == 0:
            corners = rng.integers(3, 7)
            angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
            points = c + r * np.stack([np.cos(angles), np.sin(angles)], 1)
            cv2.fillPoly(canvas, [np.round(points).astype(np.int32)], fill, cv2.LINE_AA)
        else:
            axes = (max(1, round(r)), max(1, round(r * rng.uniform(0.25, 1))))
            cv2.ellipse(
                canvas, np.round(c).astype(int).tolist(), axes, rng.uniform(0, 180), 0, 360, fill, -1, cv2.LINE_AA
            )


def _blank(rng: Rng, saturation: float = 0.35) -> Image:
    return np.full((SIZE, SIZE, 3), color(rng, saturation), np.float64).astype(np.uint8)


def _noise(rng: Rng) -> Image:
    return ramp(octaves(rng, SIZE, rng.uniform(0.45, 0.95)), palette(rng, int(rng.integers(2, 6)), 70))


def _leaves(rng: Rng) -> Image:
    canvas = _blank(rng)
    colors = np.concatenate([palette(rng, 4, 70) for _ in range(rng.integers(2, 5))])
    _scatter(rng, canvas, 500, (4, 140), colors)
    return modulate(canvas, octaves(rng, SIZE, rng.uniform(0.5, 0.95)), rng.uniform(0.1, 0.5))


def _foliage(rng: Rng) -> Image:
    canvas = np.full((SIZE, SIZE, 3), rng.uniform(5, 50), np.float64).astype(np.uint8)
    green = np.array([rng.uniform(50, 160), rng.uniform(70, 150), rng.uniform(10, 60)])
    colors = np.clip(green * rng.uniform(0.2, 1.7, (12, 1)) + rng.normal(0, 12, (12, 3)), 0, 255)
    _scatter(rng, canvas, 2200, (2.5, 14), colors)
    return modulate(canvas, octaves(rng, SIZE, 0.7), 0.5)


def _gravel(rng: Rng) -> Image:
    """Asphalt, gravel, concrete, plaster: fine grain on slow changes."""
    fine = octaves(rng, SIZE, rng.uniform(0.8, 1.1), first=int(rng.integers(3, 6)))
    slow = octaves(rng, SIZE, 0.5)
    base = color(rng, 0.08)
    strength = rng.uniform(0.05, 0.4)
    return modulate(
        modulate(ramp(fine, np.stack([base * (1 - strength), base * (1 + strength)])), slow, 0.15), fine, 0.1
    )


def _bricks(rng: Rng) -> Image:
    mortar = color(rng, 0.1)
    canvas = np.full((SIZE, SIZE, 3), mortar, np.float64).astype(np.uint8)
    h, w = int(rng.integers(14, 70)), int(rng.integers(20, 130))
    gap, jitter = int(rng.integers(1, 4)), rng.uniform(2, 40)
    shift = rng.choice([0.0, 0.5, rng.uniform(0, 1)])
    base = color(rng)
    for row, y in enumerate(range(0, SIZE, h)):
        for x in range(-w + int(shift * w * (row % 2)), SIZE, w):
            fill = np.clip(base + rng.normal(0, jitter) + rng.normal(0, jitter / 4, 3), 0, 255)
            cv2.rectangle(canvas, (x + gap, y + gap), (x + w - gap, y + h - gap), fill.tolist(), -1)
    return modulate(canvas, octaves(rng, SIZE, rng.uniform(0.5, 0.9)), rng.uniform(0.05, 0.35))


def _stripes(rng: Rng) -> Image:
    angle = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)])
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    phase = (x * np.cos(angle) + y * np.sin(angle)) / rng.uniform(8, 60)
    wave = np.sin(2 * np.pi * phase + rng.uniform(0, 3) * octaves(rng, SIZE, 0.4) * rng.integers(0, 2))
    sharp = np.clip(0.5 + wave * rng.uniform(0.5, 4), 0, 1).astype(np.float32)
    return modulate(ramp(sharp, palette(rng, 2, 80)), octaves(rng, SIZE, 0.7), rng.uniform(0.03, 0.3))


def _facade(rng: Rng) -> Image:
    """A house front: plaster or brick with a grid of windows, sills and blinds."""
    canvas = _gravel(rng) if rng.random() < 0.6 else _bricks(rng)
    columns, rows = rng.integers(2, 6), rng.integers(2, 5)
    w, h = SIZE / columns, SIZE / rows
    frame, glass = color(rng, 0.1), color(rng, 0.2) * 0.4
    share, tall = rng.uniform(0.35, 0.7), rng.uniform(0.45, 0.8)
    for i in range(rows):
        for j in range(columns):
            x0, y0 = (j + 0.5 - share / 2) * w, (i + 0.5 - tall / 2) * h
            x1, y1 = x0 + share * w, y0 + tall * h
            box = np.round([x0, y0, x1, y1]).astype(int)
            cv2.rectangle(canvas, box[:2].tolist(), box[2:].tolist(), frame.tolist(), -1)
            pane = np.clip(glass * rng.uniform(0.4, 2.2), 0, 255)
            cv2.rectangle(canvas, (box[:2] + 3).tolist(), (box[2:] - 3).tolist(), pane.tolist(), -1)
            if rng.random() < 0.3:  # blind, half down
                fall = int((box[3] - box[1]) * rng.uniform(0.2, 0.9))
                cv2.rectangle(
                    canvas, (box[:2] + 3).tolist(), (int(box[2] - 3), int(box[1] + fall)), (frame * 0.8).tolist(), -1
                )
            middle = int((box[0] + box[2]) // 2)
            cv2.line(canvas, (middle, int(box[1])), (middle, int(box[3])), frame.tolist(), 2)
    return modulate(canvas, octaves(rng, SIZE, 0.7), rng.uniform(0.05, 0.25))


def _wood(rng: Rng) -> Image:
    grain = octaves(rng, SIZE, rng.uniform(0.75, 1.0), stretch=(int(rng.integers(8, 32)), 1))
    rings = 0.5 + 0.5 * np.sin(rng.uniform(10, 60) * octaves(rng, SIZE, 0.4, stretch=(6, 1)))
    field = np.clip(0.6 * grain + 0.4 * rings, 0, 1).astype(np.float32)
    base = np.array([rng.uniform(110, 220), rng.uniform(80, 160), rng.uniform(40, 110)])
    image = ramp(field, np.stack([base * rng.uniform(0.5, 0.9), base]))
    return image if rng.random() < 0.5 else np.ascontiguousarray(image.transpose(1, 0, 2))


def _write(rng: Rng, canvas: Image, lines: int) -> None:
    fonts = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_TRIPLEX)
    y = 0.0
    for _ in range(lines):
        scale = float(rng.choice([0.4, 0.5, 0.8, 1.5, 3.0], p=[0.3, 0.3, 0.2, 0.15, 0.05]))
        y += 26 * scale + rng.uniform(2, 14)
        if y > SIZE:
            break
        text = "".join(chr(c) for c in rng.integers(33, 122, rng.integers(2, max(3, int(22 / scale)))))
        where = (int(rng.uniform(0, 30)), int(y))
        cv2.putText(
            canvas,
            text,
            where,
            int(rng.choice(fonts)),
            scale,
            color(rng).tolist(),
            max(1, int(2 * scale)),
            cv2.LINE_AA,
        )


def _text(rng: Rng) -> Image:
    canvas = modulate(_blank(rng, 0.15), octaves(rng, SIZE, 0.7), rng.uniform(0.02, 0.1))
    _write(rng, canvas, 30)
    return canvas


def _poster(rng: Rng) -> Image:
    """Print: rectangles, discs, lines and words."""
    canvas = _blank(rng)
    for _ in range(rng.integers(5, 30)):
        a, b = rng.integers(-40, SIZE, 2), rng.integers(10, 200, 2)
        cv2.rectangle(canvas, a.tolist(), (a + b).tolist(), color(rng, 0.5).tolist(), int(rng.choice([-1, -1, 2, 5])))
    for _ in range(rng.integers(0, 12)):
        center, radius = rng.integers(0, SIZE, 2), int(rng.integers(4, 80))
        cv2.circle(canvas, center.tolist(), radius, color(rng, 0.5).tolist(), int(rng.choice([-1, -1, 2])), cv2.LINE_AA)
    for _ in range(rng.integers(0, 12)):
        a, b = rng.integers(0, SIZE, (2, 2))
        cv2.line(canvas, a.tolist(), b.tolist(), color(rng).tolist(), int(rng.integers(1, 4)), cv2.LINE_AA)
    _write(rng, canvas, int(rng.integers(0, 8)))
    return modulate(canvas, octaves(rng, SIZE, 0.6), rng.uniform(0.02, 0.15))


def _plain(rng: Rng) -> Image:
    """Painted wall, plastic, paper: hardly any texture."""
    image = modulate(_blank(rng), octaves(rng, SIZE, 0.3), rng.uniform(0, 0.2))
    return modulate(image, octaves(rng, SIZE, 1.0, first=5), rng.uniform(0, 0.06))


def _fabric(rng: Rng) -> Image:
    """A small motif repeated exactly: printed cloth, wallpaper, tiles."""
    period = int(rng.choice([16, 24, 32, 48, 64, 96]))
    motif = _leaves(rng)[:SIZE:2, :SIZE:2][:period, :period] if rng.random() < 0.5 else None
    if motif is None:
        motif = np.full((period, period, 3), color(rng), np.float64).astype(np.uint8)
        _scatter(rng, motif, 8, (2, period / 2), palette(rng, 4, 80))
    times = SIZE // period + 1
    image = np.tile(motif, (times, times, 1))[:SIZE, :SIZE]
    return modulate(image, octaves(rng, SIZE, 0.6), rng.uniform(0.03, 0.3))


@functools.cache
def _photograph(name: str) -> Image:
    image = getattr(skimage.data, name)()
    return np.ascontiguousarray(np.repeat(image[..., None], 3, 2) if image.ndim == 2 else image[..., :3])


def _photo(rng: Rng) -> Image:
    image = _photograph(str(rng.choice(PHOTOS)))
    side = int(min(image.shape[:2]) * rng.uniform(0.4, 1))
    y, x = (int(rng.integers(0, n - side + 1)) for n in image.shape[:2])
    return cv2.resize(image[y : y + side, x : x + side], (SIZE, SIZE), interpolation=cv2.INTER_AREA).astype(np.uint8)


def _sky(rng: Rng) -> Image:
    """Overcast, blue or hazy, brighter downwards."""
    blue = np.array([rng.uniform(60, 200), rng.uniform(110, 215), rng.uniform(170, 255)])
    clouds = octaves(rng, SIZE, rng.uniform(0.4, 0.6), stretch=(1, 2))
    cover = np.clip((clouds - rng.uniform(0, 1)) * 3, 0, 1)[..., None]
    fall = np.linspace(0, 1, SIZE)[:, None, None]
    image = blue * (1 - fall / 2) + 255 * fall / 2 + cover * (235 - blue)
    return np.asarray(np.clip(image, 0, 255), np.uint8)


PATTERNS: dict[str, Callable[[Rng], Image]] = {
    "noise": _noise, "leaves": _leaves, "foliage": _foliage, "gravel": _gravel, "bricks": _bricks, "stripes": _stripes,
    "facade": _facade, "wood": _wood, "text": _text, "poster": _poster, "plain": _plain, "fabric": _fabric,
    "photo": _photo, "sky": _sky,
}  # fmt: skip
