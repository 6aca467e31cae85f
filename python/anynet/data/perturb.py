"""What real rigs do to a pair: rows that do not meet, little light, noise, compression, cameras that differ."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Rng = np.random.Generator


def lowered(image: Image, rows: float, degrees: float = 0.0, *, rolled: bool = True) -> Image:
    """The image so many pixels lower, and turned clockwise about its center; the border is repeated.

    Not `rolled`, only rows move, by what the turn would give them: disparities stay as they are.
    """
    height, width = image.shape[:2]
    x, y = (width - 1) / 2, (height - 1) / 2
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    turn = np.array([[cosine, -sine], [sine, cosine]]) if rolled else np.array([[1.0, 0.0], [sine, 1.0]])
    shift = np.array([x, y + rows]) - turn @ (x, y)
    matrix = np.column_stack([turn, shift])
    moved = cv2.warpAffine(image, matrix, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return moved.astype(np.uint8, copy=False)


def exposed(image: Image, gain: float, gamma: float = 1.0) -> Image:
    """Values v in 0..1 become gain * v^gamma."""
    table = np.clip(np.rint(255 * gain * np.linspace(0, 1, 256) ** gamma), 0, 255).astype(np.uint8)
    return cv2.LUT(image, table).astype(np.uint8, copy=False)


def noisy(image: Image, deviation: float, rng: Rng) -> Image:
    """With Gaussian noise of this standard deviation, in gray levels."""
    cv2.setRNGSeed(int(rng.integers(2**31)))  # four times as fast as NumPy's
    noise = np.empty((len(image), image[0].size), np.int16)
    cv2.randn(noise, np.zeros(1), np.array([deviation], np.float64))
    return cv2.add(image, noise.reshape(image.shape), dtype=cv2.CV_8U).astype(np.uint8, copy=False)


def blurred(image: Image, sigma: float) -> Image:
    """Through a Gaussian filter, sigma in pixels."""
    return cv2.GaussianBlur(image, (0, 0), sigma).astype(np.uint8, copy=False)


def compressed(image: Image, quality: int) -> Image:
    """As JPEG of this quality, 1 to 100, gives it back; OpenCV has blue first."""
    _, code = cv2.imencode(".jpg", image[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, quality))
    decoded = cv2.imdecode(code, cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.ascontiguousarray(decoded[..., ::-1], np.uint8)


PERTURBATIONS: dict[str, Callable[[Image, Image, Rng], tuple[Image, Image]]] = {
    "rows1": lambda left, right, rng: (left, lowered(right, 1)),
    "rows2": lambda left, right, rng: (left, lowered(right, 2)),
    "roll": lambda left, right, rng: (left, lowered(right, 0, 0.3)),
    "dark": lambda left, right, rng: (noisy(exposed(left, 1 / 6), 2, rng), noisy(exposed(right, 1 / 6), 2, rng)),
    "jpeg": lambda left, right, rng: (compressed(left, 30), compressed(right, 30)),
    "gamma": lambda left, right, rng: (left, exposed(right, 1, 1.4)),
    "gain": lambda left, right, rng: (left, exposed(right, 0.6)),
    "blur": lambda left, right, rng: (left, blurred(right, 1)),
}
"""By name, what `anynet evaluate --perturb` does to a pair, left and right uint8 [H, W, 3]:

* `rows1`, `rows2`: the right image 1 or 2 rows lower; `roll`: turned by 0.3 degrees
* `dark`: both at a sixth of the light, with noise of 2 gray levels; `jpeg`: both of quality 30
* `gamma`, `gain`, `blur`: the right image alone with gamma 1.4, 0.6 of the light, or a blur of 1 pixel
"""


def as_by_a_rig(left: Image, right: Image, rng: Rng, rows: float = 2.2, degrees: float = 0.4) -> tuple[Image, Image]:
    """Random faults of these kinds, each now and then, for training; disparities stay as they are.

    Half of the pairs get rows that are off, by at most `rows` and what a turn by `degrees` gives.
    """
    if rng.random() < 0.5:
        right = lowered(right, rng.uniform(-rows, rows), rng.uniform(-degrees, degrees), rolled=False)
    if rng.random() < 0.25:  # one camera exposes otherwise
        right = exposed(right, float(np.exp(rng.normal(0, 0.3))), float(np.exp(rng.normal(0, 0.2))))
    if rng.random() < 0.2:  # little light
        light, noise = np.exp(rng.uniform(np.log(1 / 8), 0)), rng.uniform(0.5, 3)
        left, right = (noisy(exposed(image, light), noise, rng) for image in (left, right))
    if rng.random() < 0.2:  # one of them, or both, out of focus
        which, sigma = rng.integers(3), rng.uniform(0.4, 1.4)
        left = blurred(left, sigma) if which != 1 else left
        right = blurred(right, sigma) if which != 0 else right
    if rng.random() < 0.2:
        quality = int(rng.integers(20, 90))
        left, right = (compressed(image, quality) for image in (left, right))
    return left, right
