"""From what the user named, files, folders or glob patterns, to pairs of images."""

from __future__ import annotations

import glob
import os
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from anynet.errors import AnyNetError


@dataclass(frozen=True)
class Pair:
    """Two image files, and the name that the results get."""

    name: str
    left: Path
    right: Path


def find_pairs(left: str, right: str) -> tuple[list[Pair], list[Path]]:
    """The pairs of two files, of two folders (the same file name in both) or of two glob patterns (in sorted order).

    Returns:
        The pairs, and the images of a folder that have no partner in the other.

    Raises:
        AnyNetError: if there is no pair, or the patterns find different numbers of files.
    """
    if os.path.isdir(left) and os.path.isdir(right):
        return _in_folders(Path(left), Path(right))
    if os.path.isdir(left) or os.path.isdir(right):
        raise AnyNetError(f"expected two folders or two files, got {left} and {right}")
    lefts, rights = _matches(left), _matches(right)
    if len(lefts) != len(rights):
        raise AnyNetError(
            f"expected as many left as right images, got {len(lefts)} for {left}, {len(rights)} for {right}"
        )
    return [Pair(*files) for files in zip(_names(lefts), lefts, rights, strict=True)], []


def _in_folders(left: Path, right: Path) -> tuple[list[Pair], list[Path]]:
    endings = Image.registered_extensions()
    images = [{p.name: p for p in sorted(folder.iterdir()) if p.suffix.lower() in endings} for folder in (left, right)]
    common = [name for name in images[0] if name in images[1]]
    if not common:
        raise AnyNetError(
            f"expected images of the same names in {left} and {right}, got {len(images[0])} and {len(images[1])} "
            "images without a common name"
        )
    alone = [path for found in images for name, path in found.items() if name not in common]
    lefts = [images[0][name] for name in common]
    return [Pair(n, path, images[1][path.name]) for n, path in zip(_names(lefts), lefts, strict=True)], alone


def _matches(pattern: str) -> list[Path]:
    """The file of that name or the files that match the pattern, sorted."""
    if os.path.exists(pattern) or not glob.has_magic(pattern):
        return [Path(pattern)]  # a missing file is told where it is read
    found = [Path(name) for name in sorted(glob.glob(pattern, recursive=True)) if os.path.isfile(name)]
    if not found:
        raise AnyNetError(f"no file matches {pattern}")
    return found


def _names(paths: list[Path]) -> list[str]:
    """One name per file: without folder and ending if that tells them apart, else with more of the path."""
    folder = os.path.commonpath([path.resolve().parent for path in paths])
    relative = [path.resolve().relative_to(folder) for path in paths]
    for names in (
        [path.stem for path in paths],
        ["_".join(path.with_suffix("").parts) for path in relative],
    ):
        if len(set(names)) == len(names):
            return names
    return ["_".join(path.parts).replace(".", "_") for path in relative]
