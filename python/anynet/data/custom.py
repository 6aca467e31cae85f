"""One's own pairs: folders of files with equal names, or a CSV."""

from __future__ import annotations

import csv
from pathlib import Path

from anynet.data.files import Files, PairFiles, folder, nothing
from anynet.errors import AnyNetError

TRUTHS = (".png", ".pfm", ".npy", ".npz")
COLUMNS = ("left", "right", "disparity", "depth", "calibration")


def folders(root: str | Path, scale: str | float | None = None) -> PairFiles:
    """root/left, root/right and root/disparity, files of one sample having the same stem.

    Args:
        scale: levels per pixel of disparity in PNG files; by default KITTI's 16 bits / 256.
    """
    wanted = "left/, right/ and disparity/ with files of equal names"
    path = folder(root, wanted)
    sides = [{f.stem: f for f in sorted((path / side).glob("*.*"))} for side in ("left", "right", "disparity")]
    left, right, truth = sides
    stems = [stem for stem in left if stem in right and stem in truth and truth[stem].suffix in TRUTHS]
    if not stems:
        raise nothing(path, wanted)
    factor = None if scale is None else float(scale)
    files = [Files(name=s, left=left[s], right=right[s], disparity=truth[s], scale=factor) for s in stems]
    return PairFiles(path.name, files)


def table(path: str | Path, scale: str | float | None = None, unit: str | None = None) -> PairFiles:
    """A CSV file with a header: left, right, and disparity, or depth (meters) with calibration.

    Paths are relative to the CSV file. In PNG files there are `scale` levels per pixel (of depth: per meter), 256 by
    default; a sample may also have no truth at all. `unit` is that of the calibrations' lengths: m, cm, mm, ...
    """
    source = Path(path)
    if not source.is_file():
        raise AnyNetError(f"{path}: expected a CSV file with columns {', '.join(COLUMNS)}; there is no such file")
    factor = None if scale is None else float(scale)
    files = []
    with source.open(newline="") as lines:
        rows = csv.DictReader(lines)
        unknown = set(rows.fieldnames or ()) - set(COLUMNS)
        if unknown or not {"left", "right"} <= set(rows.fieldnames or ()):
            raise AnyNetError(
                f"{path}: expected columns among {', '.join(COLUMNS)}, got {', '.join(rows.fieldnames or ['none'])}"
            )
        for number, row in enumerate(rows, start=2):
            place = {column: source.parent / entry for column, entry in row.items() if entry}
            if not {"left", "right"} <= set(place) or (
                "depth" in place and ("calibration" not in place or "disparity" in place)
            ):
                wanted = "left, right, and disparity or depth + calibration"
                raise AnyNetError(f"{path}:{number}: expected {wanted}, got {', '.join(place)}")
            files.append(
                Files(
                    name=place["left"].stem,
                    left=place["left"],
                    right=place["right"],
                    disparity=place.get("disparity", place.get("depth")),
                    scale=factor,
                    calibration=place.get("calibration"),
                    depth="depth" in place,
                    unit=unit,
                )
            )
    return PairFiles(source.stem, files)
