"""One's own pairs: folders of files with equal names, or a CSV."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from anynet.camera.units import meters_per
from anynet.data.files import Files, PairFiles, files_in, folder, nothing
from anynet.errors import AnyNetError
from anynet.io.disparity import FORMATS
from anynet.io.files import read_text, telling_damage
from anynet.io.images import endings
from anynet.names import distinct_names

COLUMNS = ("left", "right", "disparity", "depth", "calibration")
MAX_ROWS = 200_000


def folders(root: str | Path, scale: str | float | None = None) -> PairFiles:
    """root/left, root/right and root/disparity, files of one sample having the same stem.

    Hidden files, and those with other endings than images and disparity maps have, are left out.

    Args:
        scale: levels per pixel of disparity in PNG files; by default KITTI's 16 bits / 256.
    """
    wanted = "left/, right/ and disparity/ with files of equal names"
    path = folder(root, wanted)
    images = endings()
    left, right, truth = (
        _by_stem(path / side, known) for side, known in (("left", images), ("right", images), ("disparity", FORMATS))
    )
    stems = [stem for stem in left if stem in right and stem in truth]
    if not stems:
        raise nothing(path, wanted)
    factor = _factor(scale)
    files = [Files(name=s, left=left[s], right=right[s], disparity=truth[s], scale=factor) for s in stems]
    return PairFiles(path.name, files)


def _by_stem(place: Path, known: Collection[str]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for file in files_in(place, "*.*"):
        if file.suffix.lower() in known and (other := found.setdefault(file.stem, file)) != file:
            raise AnyNetError(f"{place}: expected one file of a name, got {other.name} and {file.name}")
    return found


def table(path: str | Path, scale: str | float | None = None, unit: str | None = None) -> PairFiles:
    """A CSV file with a header: left, right, and disparity, or depth (meters) with calibration.

    Paths are relative to the CSV file. In PNG files there are `scale` levels per pixel (of depth: per meter), 256 by
    default; a sample may also have no truth at all. `unit` is that of the calibrations' lengths: m, cm, mm, ...
    """
    source = Path(path)
    if os.path.isdir(source):
        raise AnyNetError(
            f"{path}: expected a CSV file, got a folder: one with left/, right/ and disparity/ is folders:{path}"
        )
    if not os.path.isfile(source):
        raise AnyNetError(f"{path}: expected a CSV file with columns {', '.join(COLUMNS)}; there is no such file")
    factor = _factor(scale)
    if unit is not None:
        meters_per(unit)  # which sees that there is such a one
    files: list[Files] = []
    with telling_damage(path, "not a CSV file"):
        rows = csv.DictReader(read_text(source).splitlines(keepends=True), restkey="more")
        unknown = set(rows.fieldnames or ()) - set(COLUMNS)
        if unknown or not {"left", "right"} <= set(rows.fieldnames or ()):
            got = ", ".join(map(repr, rows.fieldnames or ["none"]))[:200]
            raise AnyNetError(f"{path}: expected columns among {', '.join(COLUMNS)}, got {got}")
        if unit is not None and "depth" not in (rows.fieldnames or ()):
            raise AnyNetError(f"{path}: expected a column depth, to which unit belongs, got none")
        for row in rows:
            if len(files) == MAX_ROWS:
                raise AnyNetError(f"{path}: expected at most {MAX_ROWS} rows")
            place = {column: source.parent / entry for column, entry in row.items() if isinstance(entry, str) and entry}
            if (
                "more" in row
                or not {"left", "right"} <= set(place)
                or ("depth" in place and ("calibration" not in place or "disparity" in place))
            ):
                wanted = "left, right, and disparity or depth + calibration"
                got = ", ".join(column for column, entry in row.items() if entry)
                raise AnyNetError(f"{path}:{rows.line_num}: expected {wanted}, got {got}")
            files.append(
                Files(
                    name="",  # once all are known
                    left=place["left"],
                    right=place["right"],
                    disparity=place.get("disparity", place.get("depth")),
                    scale=factor,
                    calibration=place.get("calibration"),
                    depth="depth" in place,
                    unit=unit,
                )
            )
    names = distinct_names([row.left for row in files])
    return PairFiles(source.stem, [replace(row, name=name) for row, name in zip(files, names, strict=True)])


def _factor(scale: str | float | None) -> float | None:
    if scale is None:
        return None
    try:
        factor = float(scale)
    except ValueError:
        factor = math.nan
    if not 0 < factor < math.inf:
        raise AnyNetError(f"expected scale > 0, got {scale}")
    return factor
