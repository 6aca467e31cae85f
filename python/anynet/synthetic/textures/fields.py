"""What textures are made of: random fields and palettes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Field = NDArray[np.float32]
Rng = np.random.Generator


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
