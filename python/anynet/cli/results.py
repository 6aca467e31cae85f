"""What `predict` writes for one pair: all its files agree on what is unknown."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import numpy.typing as npt
import typer

from anynet.errors import AnyNetError

if TYPE_CHECKING:
    from anynet import Estimate
    from anynet.camera import Calibration

Image = npt.NDArray[np.uint8]
Map = npt.NDArray[np.float32]
FileId = tuple[int, int]

_FILE = re.compile(
    r"(.+?)_(?:(?:stage\d+_)?(?:disparity|color)|depth|cloud|confidence|occluded|rectified_left|rectified_right)"
    r"\.(?:png|pfm|npy|tiff|ply)"
)


def file_ids(paths: Iterable[Path]) -> frozenset[FileId]:
    """What the system calls the files, equal for all names of one; those that are not there are left out."""
    found = set()
    for path in paths:
        with suppress(OSError, ValueError):
            status = os.stat(path)
            found.add((status.st_dev, status.st_ino))
    return frozenset(found)


def check_not_inputs(outputs: Iterable[Path], inputs: frozenset[FileId]) -> None:
    """Raises AnyNetError if one of the files to write is one of those to read."""
    for path in outputs:
        if file_ids([path]) & inputs:
            raise AnyNetError(f"{path}: is one of the files to read; choose another folder for the results")


class Format(str, Enum):
    """Formats of disparity files."""

    png = "png"
    pfm = "pfm"
    npy = "npy"


class DepthFormat(str, Enum):
    """Formats of depth files."""

    tiff = "tiff"
    npy = "npy"
    png = "png"


DisparityFile = Annotated[
    Format | None,
    typer.Option(help="Disparity files: 16-bit PNG as KITTI's, PFM, or NumPy.", show_default="png"),
]
DepthFiles = Annotated[
    list[DepthFormat] | None,
    typer.Option(
        help="Depth files: TIFF or NumPy in meters, or 16-bit PNG in millimeters; repeatable.", show_default="tiff"
    ),
]


@dataclass(frozen=True)
class Writer:
    """Where to, and in which formats."""

    out: Path
    format: Format = Format.png
    depth_formats: tuple[DepthFormat, ...] = (DepthFormat.tiff,)
    max_depth: float | None = None
    """Meters; None: what half a pixel of error still tells to 20 %."""
    inputs: frozenset[FileId] = frozenset()
    """Files that are not to be overwritten."""

    def of(self, name: str) -> Results:
        """For the pair of that name."""
        return Results(self, name, self.older.get(name, []))

    @cached_property
    def older(self) -> dict[str, list[str]]:
        """Names of files like these that were there before the first pair, but for `inputs`, by the names of pairs."""
        found: dict[str, list[str]] = {}
        with suppress(OSError):  # a folder that may only be written to
            for path in self.out.iterdir():
                match = _FILE.fullmatch(path.name)
                if match and not file_ids([path]) & self.inputs:
                    found.setdefault(match[1], []).append(path.name)
        return found


@dataclass
class Results:
    """One pair's files: kind -> path, as they are written."""

    writer: Writer
    name: str
    older: list[str]
    files: dict[str, str] = field(default_factory=dict)

    def write_disparity(self, prefix: str, disparity: Map, limits: tuple[float, float]) -> None:
        """A disparity map, NaN where unknown, and its image in colors from `limits`.

        A PNG holds disparities above 0 and below 256: where others are known, a PFM is written instead, with a warning.
        """
        from anynet.io import write_disparity, write_image
        from anynet.visualize import disparity_image

        chosen = self.writer.format
        if chosen is Format.png and not _fits_png(disparity):
            warnings.warn(
                f"a PNG holds disparities above 0 and below 256 pixels, got {np.nanmin(disparity):.1f} to "
                f"{np.nanmax(disparity):.1f}: written as PFM",
                stacklevel=2,
            )
            chosen = Format.pfm
        write_disparity(self._path(f"{prefix}disparity", chosen.value), disparity)
        write_image(self._path(f"{prefix}color", "png"), disparity_image(disparity, limits))

    def write_depth(self, disparity: Map, calibration: Calibration, left: Image) -> None:
        """Depth maps and the point cloud."""
        from anynet.io import write_depth, write_ply
        from anynet.trust import within_reach

        depth = calibration.depth(disparity)
        if not np.isfinite(depth).any():
            warnings.warn(
                f"no pixel has a depth: that takes disparities above {-calibration.doffs:g} pixels (doffs), "
                f"got {_range(disparity)}",
                stacklevel=2,
            )
        for number, chosen in enumerate(dict.fromkeys(self.writer.depth_formats)):
            path = self._path("depth" if number == 0 else f"depth_{chosen.value}", chosen.value, "depth")
            write_depth(path, depth)
        near = within_reach(depth, calibration, self.writer.max_depth)
        write_ply(self._path("cloud", "ply"), calibration.points(depth)[near], left[near])

    def write_trust(self, estimate: Estimate) -> None:
        """Pictures of the confidence (white: 1) and of what the right camera does not see (white)."""
        from anynet.io import write_image

        if estimate.confidence is not None and estimate.occluded is not None:
            for kind, values in (("confidence", estimate.confidence), ("occluded", estimate.occluded)):
                gray = np.round(np.asarray(values, np.float32) * 255).astype(np.uint8)
                write_image(self._path(kind, "png"), np.repeat(gray[..., None], 3, axis=2))

    def write_images(self, left: Image, right: Image) -> None:
        """The rectified images."""
        from anynet.io import write_image

        for side, image in (("left", left), ("right", right)):
            write_image(self._path(f"rectified_{side}", "png"), image)

    def tell_older(self) -> None:
        """Warns of the pair's files from before that are not written anew, for the first pair that has some."""
        older = set(self.older) - {Path(file).name for file in self.files.values()}
        if older:
            self.writer.older.clear()
            files = ", ".join(sorted(older))
            warnings.warn(f"{self.writer.out}: not of this run, but from before: {files}", stacklevel=2)

    def _path(self, kind: str, ending: str, stem: str | None = None) -> Path:
        path = self.writer.out / f"{self.name}_{stem or kind}.{ending}"
        check_not_inputs([path], self.writer.inputs)
        self.files[kind] = str(path)
        return path


def _fits_png(disparity: Map) -> bool:
    known = disparity[np.isfinite(disparity)]
    return not known.size or (known.min() > 0 and known.max() * 256 <= 65535)


def _range(disparity: Map) -> str:
    if not np.isfinite(disparity).any():
        return "none"
    return f"{np.nanmin(disparity):.1f} to {np.nanmax(disparity):.1f}"
