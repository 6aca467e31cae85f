"""What two real cameras do to a scene: exposure, color, lens blur, noise, and a little misalignment between them."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from anynet.synthetic.textures import Image, Rng

GRAIN = 32  # one standard deviation in the stored noise


@functools.cache
def _grain() -> Image:
    """Colored noise of standard deviation GRAIN around 128, from which views cut random windows."""
    rng = np.random.default_rng(300)
    noise = rng.standard_normal((1024, 1536, 3), np.float32)
    noise = 0.7 * noise + 0.7 * rng.standard_normal((1024, 1536, 1), np.float32)
    return np.clip(128 + GRAIN * noise, 0, 255).astype(np.uint8)


def photograph(rng: Rng, left: Image, right: Image) -> tuple[Image, Image]:
    """Both images as two slightly different cameras would have taken them. uint8 [H, W, 3]."""
    gamma, contrast = np.exp(rng.normal(0, 0.25)), np.exp(rng.normal(0.15, 0.25))
    middle = float(np.mean((left[::8, ::8] / 255) ** gamma))
    gain = float(np.clip(rng.uniform(70, 165) / 255 / max(middle, 1e-3), 0.5, 3))  # automatic exposure
    lift, tint = rng.uniform(0, 0.06), rng.normal(1, 0.06, 3)
    blur = max(0.0, rng.normal(0.45, 0.25))
    noise = min(rng.exponential(rng.choice([0.8, 3.0])), 9.0)
    unlike = rng.choice([0.0, 1.0, 2.0], p=[0.4, 0.5, 0.1])  # how much the cameras differ

    def take(image: Image) -> Image:
        own_gain = gain * np.exp(rng.normal(0, 0.04) * unlike)
        own_gamma = gamma * np.exp(rng.normal(0, 0.03) * unlike)
        own_tint = tint * np.exp(rng.normal(0, 0.02, 3) * unlike)
        level = np.linspace(0, 1, 256)[:, None] ** own_gamma
        level = np.maximum(middle + contrast * (level - middle), 0)
        table = np.clip(255 * (lift + (1 - lift) * own_gain * own_tint * level), 0, 255).astype(np.uint8)
        sigma = blur + max(0.0, rng.normal(0, 0.15) * unlike)
        blurred = cv2.GaussianBlur(image, (5, 5), sigma) if sigma > 0.25 else image
        exposed = cv2.LUT(blurred, table[:, None])
        height, width = image.shape[:2]
        grain = _grain()
        if height > grain.shape[0] or width > grain.shape[1]:
            grain = np.tile(grain, (-(-height // grain.shape[0]), -(-width // grain.shape[1]), 1))
        y, x = (
            int(rng.integers(0, whole - part + 1)) for whole, part in zip(grain.shape, image.shape[:2], strict=False)
        )
        amount = noise / GRAIN
        window = grain[y : y + height, x : x + width]
        return cv2.addWeighted(exposed, 1, window, amount, -128 * amount).astype(np.uint8, copy=False)

    left, right = take(left), take(right)
    if rng.random() < 0.5:
        angle, dy = rng.normal(0, 0.0006), float(np.clip(rng.normal(0, 0.35), -1, 1))
        height, width = right.shape[:2]
        move = np.array([[1, 0, 0], [angle, 1, dy - angle * width / 2]])
        moved = cv2.warpAffine(right, move, (width, height), borderMode=cv2.BORDER_REPLICATE)
        right = moved.astype(np.uint8, copy=False)
    return left, right
