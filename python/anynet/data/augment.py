"""Random changes to training pairs. Each is a function of the sample and a generator, so a run can be repeated."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anynet.data.perturb import as_by_a_rig
from anynet.errors import AnyNetError
from anynet.samples import MAX_DISPARITY, RenderedSample, StereoSample

Rng = np.random.Generator
Image = NDArray[np.uint8]


def _crop(sample: StereoSample, window: tuple[slice, slice]) -> StereoSample:
    """The same window of every image and mask."""
    parts: dict[str, Any] = {}
    for entry in (f.name for f in fields(StereoSample)):
        value = getattr(sample, entry)
        parts[entry] = value[window] if isinstance(value, np.ndarray) else value
    return StereoSample(**parts)


def _window(shape: tuple[int, ...], size: tuple[int, int], rng: Rng, name: str) -> tuple[slice, slice]:
    if shape[0] < size[0] or shape[1] < size[1]:
        raise AnyNetError(f"{name}: a crop of {size[0]} x {size[1]} does not fit in {shape[0]} x {shape[1]} pixels")
    y, x = (int(rng.integers(0, whole - part + 1)) for whole, part in zip(shape, size, strict=False))
    return slice(y, y + size[0]), slice(x, x + size[1])


def random_crop(sample: StereoSample, size: tuple[int, int], rng: Rng) -> StereoSample:
    """A random window of `size` (height, width), the same in both views. The result's `noc` is `non_occluded`."""
    part = _crop(sample, _window(sample.disparity.shape, size, rng, sample.name))
    return replace(part, noc=non_occluded(part))


def mirrored(sample: RenderedSample) -> StereoSample:
    """The right view, mirrored, as the left one: again a proper pair, with its own disparities."""
    disparity = sample.right_disparity[:, ::-1]
    return StereoSample(
        left=cv2.flip(sample.right, 1).astype(np.uint8, copy=False),
        right=cv2.flip(sample.left, 1).astype(np.uint8, copy=False),
        disparity=disparity,
        valid=disparity < MAX_DISPARITY,
        noc=~sample.right_occluded[:, ::-1],
        name=sample.name,
    )


def _rescaled(sample: StereoSample, size: tuple[int, int], scale: float, rng: Rng) -> StereoSample:
    """A window of the sample scaled by `scale`, disparities with it. Only the window is resampled."""
    height, width = size
    shape = sample.disparity.shape
    source = min(shape[0], max(1, round(height / scale))), min(shape[1], max(1, round(width / scale)))
    part = _crop(sample, _window(shape, source, rng, sample.name))
    ratio = width / source[1]

    def resized(image: Image) -> Image:
        return cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR).astype(np.uint8, copy=False)

    def mask(flags: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        if flags is None:
            return None
        return cv2.resize(flags.view(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST_EXACT).view(np.bool_)

    disparity = cv2.resize(np.ascontiguousarray(part.disparity), (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
    return StereoSample(
        left=resized(part.left),
        right=resized(part.right),
        disparity=disparity.astype(np.float32, copy=False) * np.float32(ratio),
        valid=mask(np.ascontiguousarray(part.valid)),  # type: ignore[arg-type]
        noc=mask(None if part.noc is None else np.ascontiguousarray(part.noc)),
        foreground=mask(None if part.foreground is None else np.ascontiguousarray(part.foreground)),
        name=part.name,
    )


def _photometric(images: tuple[Image, Image], rng: Rng) -> tuple[Image, Image]:
    """Exposure, gamma, contrast and color, mostly shared by the views, partly each its own; channels permuted."""
    order = rng.permutation(3) if rng.random() < 0.5 else np.arange(3)
    gain, gamma, contrast = np.exp(rng.normal(0, 0.18)), np.exp(rng.normal(0, 0.2)), rng.uniform(0.7, 1.2)
    apart = rng.choice([0.0, 1.0, 2.0], p=[0.5, 0.4, 0.1])
    changed = []
    for image in images:
        own = np.exp(rng.normal(0, 0.05, 3) * apart + rng.normal(0, 0.04) * apart)
        level = np.linspace(0, 1, 256)[:, None] ** (gamma * np.exp(rng.normal(0, 0.05) * apart))
        table = ((level - 0.4) * contrast + 0.4) * gain * own
        table = np.clip(255 * table, 0, 255).astype(np.uint8)
        channels = cv2.split(image)
        changed.append(
            cv2.merge([cv2.LUT(channels[c], table[:, i]) for i, c in enumerate(order)]).astype(np.uint8, copy=False)
        )
    return changed[0], changed[1]


def _occlude(right: Image, rng: Rng) -> NDArray[np.bool_]:
    """Hides up to two patches of the right view behind its mean color or another part of it; returns where."""
    height, width = right.shape[:2]
    hidden = np.zeros((height, width), np.bool_)
    for _ in range(rng.integers(1, 3)):
        h = int(rng.integers(min(20, height // 8), height // 3))
        w = int(rng.integers(min(20, width // 8), width // 4))
        y, x = int(rng.integers(0, height - h)), int(rng.integers(0, width - w))
        if rng.random() < 0.5:
            right[y : y + h, x : x + w] = right[::8, ::8].mean((0, 1))
        else:
            y0, x0 = int(rng.integers(0, height - h)), int(rng.integers(0, width - w))
            right[y : y + h, x : x + w] = right[y0 : y0 + h, x0 : x0 + w].copy()
        hidden[y : y + h, x : x + w] = True
    return hidden


def non_occluded(sample: StereoSample, hidden: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Which left pixels the right image shows: those of `noc` whose match lies inside, and is not `hidden` there.

    Where the sample does not tell `noc`, all points count as seen by the right camera.
    """
    known = sample.valid if sample.noc is None else sample.valid & sample.noc
    width = known.shape[1]
    match = np.arange(width, dtype=np.float32) - np.where(sample.valid, sample.disparity, np.float32(0))
    inside = known & (match >= 0)
    if hidden is not None:
        columns = np.clip(np.rint(match), 0, width - 1).astype(np.intp)
        inside &= ~np.take_along_axis(hidden, columns, 1)
    return inside


def augment(
    sample: StereoSample,
    crop: tuple[int, int],
    rng: Rng,
    *,
    scales: tuple[float, float] = (0.7, 1.6),
    photometric: bool = True,
    occluders: float = 0.3,
    perturb: bool = False,
) -> StereoSample:
    """A random crop (height, width) of the pair, changed at random in ways that keep it a proper pair.

    Scale by a factor from `scales`, log-uniform (no smaller than the crop allows); upside down; for rendered pairs
    also mirrored with the views exchanged; exposure and color per view; with probability `occluders`, patches of the
    right view hidden (their truth stays: the network learns to fill in); with `perturb`, also what real rigs do
    (`as_by_a_rig`). The result's `noc` is `non_occluded`.

    Raises:
        AnyNetError: the crop is larger than the pair at the largest scale.
    """
    if isinstance(sample, RenderedSample) and rng.random() < 0.5:
        sample = mirrored(sample)
    shape = sample.disparity.shape
    low = max(scales[0], crop[0] / shape[0], crop[1] / shape[1])
    if low > scales[1]:
        raise AnyNetError(
            f"{sample.name}: a crop of {crop[0]} x {crop[1]} does not fit in {shape[0]} x {shape[1]} pixels, "
            f"enlarged by at most {scales[1]}"
        )
    scale = float(np.exp(rng.uniform(np.log(low), np.log(scales[1]))))
    sample = _rescaled(sample, crop, scale, rng)
    images = sample.left, sample.right
    if photometric:
        images = _photometric(images, rng)
    hidden = _occlude(images[1], rng) if rng.random() < occluders else None
    if perturb:
        images = as_by_a_rig(*images, rng)
    valid = sample.valid & (sample.disparity < MAX_DISPARITY)
    noc = valid & non_occluded(sample, hidden)
    flip = slice(None, None, -1 if rng.random() < 0.2 else 1)
    return StereoSample(
        left=images[0][flip],
        right=images[1][flip],
        disparity=sample.disparity[flip],
        valid=valid[flip],
        noc=noc[flip],
        foreground=None if sample.foreground is None else sample.foreground[flip],
        name=sample.name,
    )
