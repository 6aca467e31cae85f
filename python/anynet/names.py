"""Names of results: one per file, all different; and names in a message."""

from __future__ import annotations

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

_STAGE = re.compile(r"_stage\d+$")


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """One name per file: without folder and ending if that tells them apart, else with more of the path.

    Not with what links point to: two may point to one file.
    """
    names = [path.stem for path in paths]
    if numbered(names) == names:
        return names
    whole = [Path(os.path.abspath(path)) for path in paths]
    above = len(Path(os.path.commonpath([path.parent for path in whole])).parts)
    names = ["_".join((*path.parent.parts[above:], path.stem)) for path in whole]
    if numbered(names) == names:
        return names
    return numbered(["_".join(path.parts[above:]).replace(".", "_") for path in whole])


def listed(names: Sequence[str], most: int) -> str:
    """The first `most` of the names, and how many more there are, if there are."""
    more = f" (and {len(names) - most} more)" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def numbered(names: Iterable[str]) -> list[str]:
    """The names, with a number behind those whose results would overwrite another's.

    File systems may take names for equal that differ in case or in the form of accents. NAME_stage1 is taken by the
    earlier stages of NAME.
    """
    taken: set[str] = set()
    reserved: set[str] = set()  # the names of which one is an earlier stage's
    numbers: Counter[str] = Counter()
    result = []
    for name in names:
        candidate = name
        while (
            (key := unicodedata.normalize("NFKC", candidate.casefold())) in taken
            or key in reserved
            or _STAGE.sub("", key) in taken
        ):
            numbers[name] += 1
            candidate = f"{name}_{numbers[name] + 1}"
        taken.add(key)
        if _STAGE.search(key):
            reserved.add(_STAGE.sub("", key))
        result.append(candidate)
    return result
