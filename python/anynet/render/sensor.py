"""What two real cameras do to a scene: exposure, colour, lens blur, noise, and a little misalignment between them."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from anynet.render.textures import Image, Rng

GRAIN = 32  # one standard deviation in the stored noise


@functools.cache
def _grain() -> Image:
    """Coloured noise of standard deviation GRAIN around 128, from which views cut random windows."""
    rng = np.random.default_rng(300)
    noise = rng.standard_normal((1024, 1536, 3), np.float32)
    noise = 0.7 * noise + 0.7 * rng.standard_normal((1024, 1536, 1), np.float32)
    return np.clip(128 + GRAIN * noise, 0, 255).astype(np.uint8)


def photograph(rng: Rng, left: Image, right: Image) -> tuple[Image, Image]:
    """Both images as two slightly different cameras would have taken them. uint8 [H, W, 3]."""
    gamma = np.exp(rng.normal(0, 0.25))
    brightness = 255 * np.mean((left[::8, ::8] / 255) ** gamma)
    gain = float(np.clip(rng.uniform(70, 150) / max(brightness, 1), 0.5, 3))  # automatic exposure
    lift, tint = rng.uniform(0, 0.06), rng.normal(1, 0.06, 3)
    blur = max(0.0, rng.normal(0.45, 0.25))
    noise = min(rng.exponential(2.2), 9.0)
    unlike = rng.choice([0.0, 1.0, 3.0], p=[0.3, 0.55, 0.15])  # how much the cameras differ
    images = []
    for image in (left, right):
        own_gain = gain * np.exp(rng.normal(0, 0.04) * unlike)
        own_gamma = gamma * np.exp(rng.normal(0, 0.03) * unlike)
        own_tint = tint * np.exp(rng.normal(0, 0.02, 3) * unlike)
        level = np.linspace(0, 1, 256)[:, None] ** own_gamma
        table = np.clip(255 * (lift + (1 - lift) * own_gain * own_tint * level), 0, 255).astype(np.uint8)[:, None]
        sigma = blur + max(0.0, rng.normal(0, 0.15) * unlike)
        if sigma > 0.25:
            image = cv2.GaussianBlur(image, (5, 5), sigma)
        image = cv2.LUT(image, table)
        height, width = image.shape[:2]
        grain = _grain()
        y, x = rng.integers(0, grain.shape[0] - height + 1), rng.integers(0, grain.shape[1] - width + 1)
        amount = noise / GRAIN
        images.append(
            cv2.addWeighted(image, 1, grain[y : y + height, x : x + width], amount, -128 * amount).astype(np.uint8)
        )
    if rng.random() < 0.5:
        angle, dy = rng.normal(0, 0.0006), float(np.clip(rng.normal(0, 0.35), -1, 1))
        height, width = right.shape[:2]
        move = np.array([[1, 0, 0], [angle, 1, dy - angle * width / 2]])
        images[1] = cv2.warpAffine(images[1], move, (width, height), borderMode=cv2.BORDER_REPLICATE).astype(np.uint8)
    return images[0], images[1]
