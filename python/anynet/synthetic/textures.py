"""Materials for the renderer: a bank of textures and of cut-out shapes, generated once per process and then reused.

Textures are procedural but for `photo`, which crops the public-domain and CC0 pictures that scikit-image carries
(astronaut, brick, camera, chelsea, coffee, grass, gravel, hubble_deep_field, retina, rocket).
Every entry has its own fixed seed, so a scene depends on the scene's seed alone.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence

import cv2
import numpy as np
import skimage.data
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Field = NDArray[np.float32]
Rng = np.random.Generator

SIZE = 384  # texels along a side of a texture
SHAPE_SIZE = 256  # ... of a cut-out shape
VARIANTS = 20  # entries per kind
PHOTOS = (  # see the licenses above
    "astronaut", "brick", "camera", "chelsea", "coffee", "grass", "gravel", "hubble_deep_field", "retina", "rocket",
)  # fmt: skip


def octaves(rng: Rng, size: int, roughness: float, stretch: tuple[int, int] = (1, 1), first: int = 0) -> Field:
    """Sum of random fields of doubling frequency from 2^first, amplitude `roughness` per octave, scaled to [0, 1]."""
    total = np.zeros((size, size), np.float32)
    cells, amplitude = 2 * 2**first, 1.0
    while cells <= size:
        shape = (max(2, cells // stretch[0]), max(2, cells // stretch[1]))
        noise = rng.standard_normal(shape, np.float32)
        total += amplitude * cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
        cells, amplitude = cells * 2, amplitude * roughness
    low, high = np.percentile(total[::4, ::4], (1, 99))
    return np.asarray(np.clip((total - low) / (high - low), 0, 1))


def color(rng: Rng, saturation: float = 0.35) -> NDArray[np.float64]:
    """A random RGB color in 0..255; like things in photographs, mostly not very saturated."""
    s = min(1.0, rng.exponential(saturation))
    value = rng.uniform(30, 250)
    hue = rng.uniform(0, 6)
    wheel = np.clip(np.abs((hue + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    return np.asarray(value * (1 - s + s * wheel))


def palette(rng: Rng, count: int, spread: float = 60, saturation: float = 0.35) -> NDArray[np.float64]:
    """`count` colors around one base color, differing mostly in brightness."""
    base = color(rng, saturation)
    light = rng.normal(0, spread, (count, 1))
    return np.clip(base + light + rng.normal(0, spread / 3, (count, 3)), 0, 255)


def ramp(field: Field, colors: NDArray[np.float64]) -> Image:
    """Colors a field in [0, 1] by piecewise-linear interpolation between `colors`."""
    steps = np.linspace(0, 1, len(colors))
    table = np.stack([np.interp(np.linspace(0, 1, 256), steps, colors[:, c]) for c in range(3)], 1)
    return table.astype(np.uint8)[(field * 255).astype(np.uint8)]


def modulate(image: Image, field: Field, strength: float) -> Image:
    """Multiplies brightness by 1 +- strength following a field in [0, 1]."""
    gain = 1 + strength * (2 * field - 1)
    return np.clip(image * gain[..., None], 0, 255).astype(np.uint8)


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


def car_profile(variant: int) -> NDArray[np.float64]:
    """Outline of a car's side from bumper to bumper over the roof: [9, 2] of (along, height) in 0..1."""
    rng = np.random.default_rng([300, variant])
    belt = rng.uniform(0.5, 0.65)
    bonnet, pillar = rng.uniform(0.05, 0.3), rng.uniform(0.06, 0.16)
    rear, slope = rng.uniform(0.8, 0.99), rng.uniform(0.01, 0.16)
    nose, tail = belt * rng.uniform(0.75, 0.95), belt * rng.uniform(0.9, 1.1)
    return np.array([
        (0, 0), (0, nose), (bonnet, belt), (bonnet + pillar, 1), (0.5 * (bonnet + pillar + rear), 1.0),
        (rear - slope, 0.98), (rear, tail), (1, tail * 0.97), (1, 0),
    ])  # fmt: skip


def _car(variant: int, glass: bool) -> Image:
    points = car_profile(variant)
    if glass:  # the part above the belt, shrunk
        points = points[2:7]
        points = points.mean(0) + 0.8 * (points - points.mean(0))
    mask = np.zeros((SHAPE_SIZE, SHAPE_SIZE), np.uint8)
    pixels = np.stack([points[:, 0], 1 - points[:, 1]], 1) * (SHAPE_SIZE - 1)
    cv2.fillPoly(mask, [np.round(pixels).astype(np.int32)], 255, cv2.LINE_AA)
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


_TEXTURES: dict[str, Callable[[Rng], Image]] = {
    "noise": _noise, "leaves": _leaves, "foliage": _foliage, "gravel": _gravel, "bricks": _bricks, "stripes": _stripes,
    "facade": _facade, "wood": _wood, "text": _text, "poster": _poster, "plain": _plain, "fabric": _fabric,
    "photo": _photo, "sky": _sky,
}  # fmt: skip
_SHAPES: dict[str, Callable[[Rng], Image]] = {
    "ellipse": _ellipse, "polygon": _polygon, "blob": _blob, "canopy": _canopy, "soft": _soft, "fence": _fence,
    "branches": _branches, "fronds": _fronds, "wires": _wires, "ring": _ring,
    "wheel": _wheel,
}  # fmt: skip
TEXTURES = tuple(_TEXTURES)
SHAPES = tuple(_SHAPES)


def _pyramid(image: Image) -> tuple[Image, ...]:
    levels = [image]
    while levels[-1].shape[0] > 6:
        levels.append(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.uint8))
    return tuple(levels)


@functools.cache
def texture(kind: str, variant: int) -> Sequence[Image]:
    """Mip pyramid of one texture, uint8 [size, size, 3], finest level first."""
    return _pyramid(_TEXTURES[kind](np.random.default_rng([TEXTURES.index(kind), variant])))


@functools.cache
def shape(kind: str, variant: int) -> Sequence[Image]:
    """Mip pyramid of one cut-out shape, uint8 [size, size], 255 inside."""
    if kind in ("car", "car glass"):
        return _pyramid(_car(variant, kind == "car glass"))
    return _pyramid(_SHAPES[kind](np.random.default_rng([100 + SHAPES.index(kind), variant])))


@functools.cache
def relief(variant: int) -> tuple[Field, Image]:
    """A height field [64, 64] in [-1, 1] and the brightness (uint8, 128 = unchanged) a slanted light gives it."""
    rng = np.random.default_rng([200, variant])
    roughness = rng.uniform(0.15, 0.5)
    size = 64
    height = 2 * octaves(rng, 256, roughness, stretch=((1, 1), (3, 1), (1, 3))[variant % 3])[::4, ::4] - 1
    height = cv2.GaussianBlur(height, (0, 0), 1.2).astype(np.float32)
    slope = cv2.Sobel(height, cv2.CV_32F, 1, 0) + cv2.Sobel(height, cv2.CV_32F, 0, 1)
    shade = np.clip(128 * (1 + rng.uniform(0.2, 0.7) * slope / (3 * slope.std())), 30, 255).astype(np.uint8)
    assert height.shape == (size, size)
    return height, shade
