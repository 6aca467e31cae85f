"""Images of disparity maps: in colors with a color bar, the stages side by side, the error against ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from anynet.errors import AnyNetError

RGBImage = npt.NDArray[np.uint8]  # [H, W, 3] RGB
Map = npt.NDArray[np.float32]  # [H, W], NaN where unknown
Limits = tuple[float, float]

UNKNOWN = (128, 128, 128)  # gray: no color of the maps below
_BACKGROUND = (255, 255, 255)
_INK = (0, 0, 0)
# ColorBrewer's diverging scale of eleven colors.
_BLUE_TO_RED = np.array(
    [
        (49, 54, 149),
        (69, 117, 180),
        (116, 173, 209),
        (171, 217, 233),
        (224, 243, 248),
        (255, 255, 191),
        (254, 224, 144),
        (253, 174, 97),
        (244, 109, 67),
        (215, 48, 39),
        (165, 0, 38),
    ]
)
_WORST = 6.0  # pixels of error where the scale ends; its middle is D1's and bad-3's threshold


def limits_of(values: Map) -> Limits:
    """The range that the colors should span: all known values but 1 % at either end; (0, 1) if nothing is known."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return 0.0, 1.0
    low, high = (float(limit) for limit in np.percentile(known, (1, 99)))
    return low, max(high, low + 1e-3)


def colorize(values: Map, limits: Limits, colormap: str = "turbo") -> RGBImage:
    """Values [H, W] as colors of a color map ("turbo", "blue-red"), its ends at `limits`; gray where not finite.

    Raises:
        AnyNetError: if there is no such color map, or the first limit is not below the second.
    """
    low, high = limits
    if not low < high:
        raise AnyNetError(f"colorize: expected limits of which the first is lower, got {low:g} and {high:g}")
    known = np.isfinite(values)
    levels = np.where(known, (values - low) * (255 / (high - low)), 0).clip(0, 255).astype(np.uint8)
    image = _table(colormap)[levels]
    image[~known] = UNKNOWN
    return image


def disparity_image(disparity: Map, limits: Limits | None = None) -> RGBImage:
    """A disparity map in colors (blue: far, red: near), with its color bar to the right."""
    limits = limits or limits_of(disparity)
    return np.hstack([colorize(disparity, limits), colorbar(len(disparity), limits, "px", "turbo")])


def error_image(disparity: Map, truth: Map) -> RGBImage:
    """|disparity - truth| in colors (blue: right, red: 6 px or more off; gray: no ground truth), with its color bar."""
    limits = (0.0, _WORST)
    errors = np.abs(disparity - truth)
    return np.hstack([colorize(errors, limits, "blue-red"), colorbar(len(errors), limits, "px off", "blue-red")])


def colorbar(height: int, limits: Limits, unit: str, colormap: str) -> RGBImage:
    """A strip of the colors with their values, and the color of unknown, as high as the image it stands beside."""
    size = max(9, min(14, height // 12))
    font = ImageFont.load_default(size)
    strip = Image.new("RGB", (7 * size, height), _BACKGROUND)
    draw = ImageDraw.Draw(strip)
    top, bottom = 2 * size, max(2 * size + 1, height - 3 * size)
    ramp = np.linspace(limits[1], limits[0], bottom - top, dtype=np.float32)[:, None].repeat(size, axis=1)
    strip.paste(Image.fromarray(colorize(ramp, limits, colormap)), (size // 2, top))
    draw.text((size // 2, size), unit, _INK, font, anchor="lm")
    for share in (0, 0.25, 0.5, 0.75, 1) if bottom - top > 6 * size else (0, 1):
        value = limits[0] + share * (limits[1] - limits[0])
        digits = 0 if limits[1] - limits[0] >= 20 else 1
        draw.text((2 * size, bottom - share * (bottom - top)), f"{value:.{digits}f}", _INK, font, anchor="lm")
    swatch = height - 2 * size
    draw.rectangle((size // 2, swatch, size // 2 + size - 1, swatch + size - 1), UNKNOWN)
    draw.text((2 * size, swatch + size // 2), "unknown", _INK, font, anchor="lm")
    return np.asarray(strip)


def panels(images: Sequence[tuple[str, RGBImage]], columns: int = 2) -> RGBImage:
    """Titled images in rows of `columns`, each column as wide as its widest image."""
    font = ImageFont.load_default(16)
    gap, title = 8, 26
    rows = [images[start : start + columns] for start in range(0, len(images), columns)]
    widths = [max(row[c][1].shape[1] for row in rows if c < len(row)) for c in range(min(columns, len(images)))]
    heights = [title + max(image.shape[0] for _, image in row) for row in rows]
    size = (sum(widths) + gap * (len(widths) + 1), sum(heights) + gap * (len(heights) + 1))
    canvas = Image.new("RGB", size, _BACKGROUND)
    draw = ImageDraw.Draw(canvas)
    y = gap
    for row, height in zip(rows, heights, strict=True):
        x = gap
        for (name, image), width in zip(row, widths, strict=False):
            draw.text((x, y + title // 2), name, _INK, font, anchor="lm")
            canvas.paste(Image.fromarray(image), (x, y + title))
            x += width + gap
        y += height + gap
    return np.asarray(canvas)


def stages_image(left: RGBImage, stages: Sequence[tuple[str, Map]], truth: Map | None = None) -> RGBImage:
    """The left image and every stage in the same colors; if known, the ground truth and the first and last errors."""
    limits = limits_of(stages[-1][1] if truth is None else truth)
    images = [("left image", left)]
    if truth is not None:
        images.append(("ground truth", disparity_image(truth, limits)))
    images += [(title, disparity_image(disparity, limits)) for title, disparity in stages]
    if truth is not None:
        images += [(f"error of {title}", error_image(disparity, truth)) for title, disparity in (stages[0], stages[-1])]
    return panels(images)


@cache
def _table(colormap: str) -> npt.NDArray[np.uint8]:
    """The color map's 256 colors, [256, 3]."""
    levels = np.arange(256, dtype=np.uint8)
    if colormap == "turbo":
        return np.ascontiguousarray(cv2.applyColorMap(levels[None], cv2.COLORMAP_TURBO)[0, :, ::-1], np.uint8)
    if colormap != "blue-red":
        raise AnyNetError(f"colorize: expected colormap 'turbo' or 'blue-red', got {colormap!r}")
    places = np.linspace(0, 255, len(_BLUE_TO_RED))
    return np.stack([np.interp(levels, places, channel).round() for channel in _BLUE_TO_RED.T], -1).astype(np.uint8)
