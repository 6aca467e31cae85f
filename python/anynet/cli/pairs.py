"""From what the user named, files, folders or glob patterns, to pairs of images."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path

from anynet.errors import AnyNetError
from anynet.io.images import endings
from anynet.names import distinct_names

_WILDCARD = re.compile(r"(\*\*/|\*+|\?|\[!?\]?[^\]]*\])")


@dataclass(frozen=True)
class Pair:
    """Two image files, and the name that the results get."""

    name: str
    left: Path
    right: Path


def share_of(pairs: list[Pair], shard: str) -> list[Pair]:
    """The pairs of one of several processes, every N-th from the I-th on.

    Args:
        shard: "I/N", I from 1 to N.

    Raises:
        AnyNetError: if it is not that.
    """
    found = re.fullmatch(r"(\d{1,7})/(\d{1,7})", shard)
    number, count = map(int, found.groups()) if found else (0, 0)
    if not 1 <= number <= count:
        raise AnyNetError(f"--shard: expected I/N with I from 1 to N, like 1/4, got {shard!r}")
    return pairs[number - 1 :: count]


def find_pairs(left: str, right: str) -> tuple[list[Pair], list[Path]]:
    """The pairs of two files, of two folders or of two glob patterns.

    In folders, files of one name are a pair; hidden ones are left out. Of patterns those are where the wildcards stand
    for the same text, or else the same numbers; where no two files agree, the patterns' files in sorted order.

    Returns:
        The pairs, whose names differ on every file system, and the images that have no partner.

    Raises:
        AnyNetError: if there is no pair, or the patterns find different numbers of files that do not agree.
    """
    if os.path.isdir(left) and os.path.isdir(right):
        return _in_folders(Path(left), Path(right))
    if os.path.isdir(left) or os.path.isdir(right):
        raise AnyNetError(f"expected two folders or two files, got {left} and {right}")
    return _in_patterns(left, right)


def _in_folders(left: Path, right: Path) -> tuple[list[Pair], list[Path]]:
    known = endings()
    images: list[dict[Hashable, Path]] = [
        {name: folder / name for name in sorted(os.listdir(folder)) if name[0] != "." and _ending(name) in known}
        for folder in (left, right)
    ]
    if not images[0].keys() & images[1].keys():
        raise AnyNetError(
            f"expected images of the same names in {left} and {right}, got {len(images[0])} and {len(images[1])} "
            "images without a common name"
        )
    return _matched(*images)


def _ending(name: str) -> str:
    return os.path.splitext(name)[1].lower()


def _in_patterns(left: str, right: str) -> tuple[list[Pair], list[Path]]:
    lefts, rights = _matches(left), _matches(right)
    for key in (_text, _numbers):
        keyed = [_by_key(paths, pattern, key) for paths, pattern in ((lefts, left), (rights, right))]
        if keyed[0].keys() & keyed[1].keys():
            return _matched(*keyed)
    if len(lefts) != len(rights):
        raise AnyNetError(
            f"expected as many left as right images, got {len(lefts)} for {left}, {len(rights)} for {right}"
        )
    return _matched(dict(enumerate(map(Path, lefts))), dict(enumerate(map(Path, rights))))


def _matched(left: Mapping[Hashable, Path], right: Mapping[Hashable, Path]) -> tuple[list[Pair], list[Path]]:
    """The images of equal keys as pairs, in the left ones' order, and those without a partner."""
    common = [key for key in left if key in right]
    alone = [path for key, path in left.items() if key not in right]
    alone += [path for key, path in right.items() if key not in left]
    names = distinct_names([left[key] for key in common])
    return [Pair(name, left[key], right[key]) for name, key in zip(names, common, strict=True)], alone


def _matches(pattern: str) -> list[str]:
    """The file of that name or the files that match the pattern, sorted."""
    if os.path.exists(pattern) or not glob.has_magic(pattern):
        return [pattern]  # a missing file is told where it is read
    found = [name for name in sorted(glob.glob(pattern, recursive=True)) if os.path.isfile(name)]
    if not found:
        raise AnyNetError(f"no file matches {pattern}")
    return found


def _by_key(
    paths: list[str], pattern: str, key: Callable[[tuple[str, ...]], tuple[Hashable, ...]]
) -> dict[Hashable, Path]:
    """The paths by what the wildcards stand for; empty if that does not tell them apart."""
    pieces = _WILDCARD.split(pattern)
    fixed = [re.escape(piece) for piece in pieces[::2]]
    wild = [_group(piece) for piece in pieces[1::2]]
    expression = re.compile("".join(a + b for a, b in zip(fixed, [*wild, ""], strict=True)), re.DOTALL)
    found = [expression.fullmatch(path) for path in paths]
    keyed: dict[Hashable, Path] = {
        key(match.groups()): Path(path) for match, path in zip(found, paths, strict=True) if match is not None
    }
    return keyed if len(keyed) == len(paths) and () not in keyed else {}


def _group(wildcard: str) -> str:
    return {"**/": "((?:.*/)?)", "**": "(.*)", "*": "([^/]*)"}.get(wildcard, "([^/])")


def _text(wildcards: tuple[str, ...]) -> tuple[Hashable, ...]:
    return wildcards


def _numbers(wildcards: tuple[str, ...]) -> tuple[Hashable, ...]:
    return tuple(number.lstrip("0") for text in wildcards for number in re.findall("[0-9]+", text))
