"""Pairs in files: what the loaders of all layouts share."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anynet.camera import Calibration, read_calibration
from anynet.errors import AnyNetError
from anynet.io import read_depth, read_disparity, read_pair
from anynet.io.files import read_text
from anynet.io.images import open_image
from anynet.samples import Dataset, StereoSample

Disparity = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Files:
    """Where one sample's parts are, and how they are coded.

    scale: levels per pixel of disparity in PNG and PGM files; None: KITTI's 16 bits / 256.
    noc: a mask (255 = seen by both), or a disparity map known only there.
    other: the right view's disparity, from which `noc` is found by comparison where there is no file for it.
    depth: whether `disparity` holds meters along the optical axis instead, to be converted with `calibration`.
    unit: of the calibration's lengths, if not its format's.
    foreground: an object map, 0 = background.
    """

    name: str
    left: Path
    right: Path
    disparity: Path | None = None
    scale: float | None = None
    noc: Path | None = None
    other: Path | None = None
    foreground: Path | None = None
    calibration: Path | None = None
    depth: bool = False
    unit: str | None = None


class PairFiles(Dataset):
    """Samples read from files when asked for."""

    def __init__(self, name: str, files: Sequence[Files]) -> None:
        self.name = name
        self.files = list(files)

    def __len__(self) -> int:
        return len(self.files)

    def load(self, index: int) -> StereoSample:
        files = self.files[index]
        left, right = read_pair(files.left, files.right)
        shape = left.shape[:2]
        if files.disparity is None:
            disparity = np.full(shape, np.nan, np.float32)
        else:
            disparity = _map(files.disparity, files.scale, shape, files.depth)
        if files.depth:
            assert files.calibration is not None
            calibration = read_calibration(
                files.calibration, unit=files.unit, size=(shape[1], shape[0]), image=files.left
            )
            if not isinstance(calibration, Calibration):
                raise AnyNetError(f"{files.calibration}: expected a calibration of rectified images, got raw cameras")
            calibration.check_size(shape[1], shape[0])
            with np.errstate(divide="ignore"):  # a depth of 0 is unknown
                disparity = np.float32(calibration.focal * calibration.baseline) / disparity
            disparity = np.where(disparity > 0, disparity - np.float32(calibration.doffs), np.float32(np.nan))
        valid = np.isfinite(disparity)
        return StereoSample(
            left=left,
            right=right,
            disparity=disparity,
            valid=valid,
            noc=_noc(files, disparity, valid),
            foreground=None if files.foreground is None else np.asarray(_levels(files.foreground, shape) > 0),
            name=files.name,
        )


def _levels(path: Path, shape: tuple[int, ...]) -> NDArray[np.integer]:
    levels = np.asarray(open_image(path))
    if levels.shape != shape:
        raise AnyNetError(f"{path}: expected {shape[1]} x {shape[0]} pixels of one channel, got shape {levels.shape}")
    return levels


def _map(path: Path, scale: float | None, shape: tuple[int, ...], depth: bool = False) -> Disparity:
    if path.suffix == ".pgm":
        levels = _levels(path, shape).astype(np.float32)
        return np.where(levels > 0, levels / np.float32(scale or 1), np.float32(np.nan))
    disparity = read_depth(path, scale) if depth else read_disparity(path, scale)
    if disparity.shape != shape:
        raise AnyNetError(
            f"{path}: expected {shape[1]} x {shape[0]} pixels like the images, got {disparity.shape[::-1]}"
        )
    return disparity


def _noc(files: Files, disparity: Disparity, valid: Mask) -> Mask | None:
    if files.noc is not None:
        if files.noc.name.startswith("mask"):
            return np.asarray(valid & (_levels(files.noc, disparity.shape) == 255))
        return valid & np.isfinite(_map(files.noc, files.scale, disparity.shape))
    if files.other is not None:
        return valid & consistent(disparity, _map(files.other, files.scale, disparity.shape))
    return None


def consistent(disparity: Disparity, other: Disparity, tolerance: float = 1.0) -> Mask:
    """Where the right view's disparity `other` says the same (to `tolerance` pixels) at the matching pixel."""
    height, width = disparity.shape
    known = np.isfinite(disparity)
    column = np.rint(np.arange(width) - np.where(known, disparity, 0)).astype(int)
    there = other[np.arange(height)[:, None], np.clip(column, 0, width - 1)]
    return np.asarray(known & (column >= 0) & (np.abs(there - disparity) <= tolerance))


def folder(root: str | Path, what: str) -> Path:
    """The root as an absolute path, which has a name. Raises AnyNetError if it is no folder; `what` should be there."""
    path = Path(root)
    if not os.path.isdir(path):
        raise AnyNetError(f"{root}: expected a folder with {what}; there is no such folder")
    return path.resolve() if ".." in path.parts else path.absolute()  # links stay what they are, unless .. follows


def nothing(root: Path, what: str) -> AnyNetError:
    """The error of a root that has no samples: what was looked for, and what is there instead."""
    found = sorted(p.name + "/" * p.is_dir() for p in root.iterdir())
    listing = ", ".join(found[:8]) + (", ..." if len(found) > 8 else "")
    return AnyNetError(f"{root}: expected {what}; found {listing or 'an empty folder'}")


def files_in(place: Path, pattern: str) -> list[Path]:
    """Files that match, sorted, without hidden ones, such as macOS puts beside others (._NAME), and without pipes."""
    if not os.path.isdir(place):  # unlike Path's, it takes names that are too long for the system
        return []
    return sorted(path for path in place.glob(pattern) if path.name[0] != "." and os.path.isfile(path))


def first_existing(paths: Iterable[Path]) -> Path | None:
    return next((path for path in paths if os.path.exists(path)), None)


def names_in(split: str | Path, root: Path) -> list[str]:
    """The names in a split file, one a line; its path is taken relative to `root`, else to the working folder."""
    path = first_existing((root / split, Path(split)))
    if path is None:
        raise AnyNetError(f"{split}: no such split file, neither in {root} nor in the working folder")
    return [line.split()[0] for line in read_text(path).splitlines() if line.strip()]
