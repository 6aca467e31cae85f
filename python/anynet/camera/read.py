"""Calibration files of any kind to one `Calibration` or `StereoRig`."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from anynet.camera.calibration import Calibration
from anynet.camera.document import Document, open_document
from anynet.camera.formats import FORMATS, Format
from anynet.camera.formats.found import Found, Request
from anynet.camera.plausibility import check_baseline
from anynet.camera.rig import StereoRig
from anynet.camera.units import meters_per
from anynet.errors import AnyNetError
from anynet.io.files import telling_damage

_ENDINGS = {".txt", ".yaml", ".yml", ".xml", ".json", ".conf", ".ini", ".cfg"}
_MOST = 200  # files of a folder
_VALUES = ("focal", "baseline", "cx", "cy", "doffs")
OPTIONS = "--focal and --baseline (with --cx, --cy, --doffs)"


def read_calibration(
    paths: str | Path | Sequence[str | Path],
    *,
    unit: str | None = None,
    size: tuple[int, int] | None = None,
    pair: str | None = None,
    image: str | Path | None = None,
    replace: Mapping[str, float] | None = None,
) -> Calibration | StereoRig:
    """Reads a calibration of any of the formats in docs/calibration.md, told apart by their content.

    What looks wrong but may be meant, such as a baseline of 193 m, is told by `warnings.warn`.

    Args:
        paths: the file; or those of the left and the right camera, or of cameras and their places; or a folder of them.
        unit: of the files' lengths: "m", "cm", "mm", ...; by default the format's, meters if it has none.
        size: width and height of the images, for files that have several resolutions.
        pair: "gray" or "color", for KITTI's four cameras; by default as the image's folder says, else color.
        image: a left image, to tell that folder.
        replace: focal, baseline, cx, cy, doffs (pixels; meters) in place of the file's.

    Returns:
        A `Calibration` of rectified images, or a `StereoRig` of raw ones. Files that tell both give a `Calibration`
        with its `rig`, unless they come with raw images (those of `anynet calibrate`).

    Raises:
        AnyNetError: if a file is missing, damaged, of no known format, lacks a field, or is of no usable pair.
    """
    given = [Path(path) for path in ([paths] if isinstance(paths, (str, os.PathLike)) else paths)]
    if not given:
        raise AnyNetError("expected a calibration file, got none")
    image = None if image is None else Path(image)
    request = Request(None if unit is None else meters_per(unit), size, image, pair)
    folder = len(given) == 1 and os.path.isdir(given[0])
    documents = _in_folder(given[0]) if folder else [open_document(path) for path in given]
    where = ", ".join(str(document.path) for document in documents)
    try:
        with telling_damage(where, "damaged calibration"):
            format = _format(documents)
            if pair is not None and format.name != "KITTI":
                raise AnyNetError(f"pair (--calib-pair) belongs to KITTI's calibrations, got one of {format.name}")
            found = format.read(documents, request)
            result = _finished(found, replace or {})
    except AnyNetError as error:
        raise AnyNetError(str(error) if where in str(error) else f"{where}: {error}") from error
    hint = "--baseline is in meters" if "baseline" in (replace or {}) else ""
    for warning in (*found.warnings, *check_baseline(result.baseline, hint)):
        warnings.warn(f"{where}: {warning}", stacklevel=2)
    return result


def _format(documents: Sequence[Document]) -> Format:
    for candidate in FORMATS:
        if len(documents) <= candidate.files and candidate.recognizes(documents):
            return candidate
    names = ", ".join(candidate.name for candidate in FORMATS)
    if len(documents) > 1:
        raise AnyNetError(f"expected the files of one calibration of {names}, got files that do not belong together")
    raise AnyNetError(f"expected a calibration of {names}, got something else; give {OPTIONS} instead")


def _in_folder(folder: Path) -> list[Document]:
    """The documents of the one calibration in a folder, or in folders of the cameras in it (cam0/sensor.yaml)."""
    files = sorted(_candidates(folder))
    if not files:
        raise AnyNetError(f"{folder}: expected calibration files in the folder ({', '.join(sorted(_ENDINGS))})")
    if len(files) > _MOST:
        raise AnyNetError(f"{folder}: expected at most {_MOST} files in a folder of calibrations, got {len(files)}")
    documents = []
    for path in files:
        try:
            documents.append(open_document(path))
        except AnyNetError:
            continue  # something else lies there, too
    for candidate in FORMATS:
        of_it = [document for document in documents if candidate.recognizes([document])]
        if 1 <= len(of_it) <= candidate.files:
            return of_it
        if of_it:
            names = ", ".join(document.path.name for document in of_it[:6])
            raise AnyNetError(f"{folder}: expected the files of one calibration, got {names}; name those to use")
    raise AnyNetError(f"{folder}: no calibration of a known format in the folder; give {OPTIONS} instead")


def _candidates(folder: Path) -> Iterable[Path]:
    try:
        entries = sorted(folder.iterdir())
        inner = [entry / "sensor.yaml" for entry in entries if entry.is_dir() and entry.name.startswith("cam")]
        return [p for p in (*entries, *inner) if p.suffix.lower() in _ENDINGS and p.name[0] != "." and p.is_file()]
    except OSError as error:
        raise AnyNetError(f"cannot read {folder}: {error.strerror}") from error


def _finished(found: Found, replace: Mapping[str, float]) -> Calibration | StereoRig:
    unknown = set(replace) - set(_VALUES)
    if unknown:
        raise AnyNetError(f"expected values of {', '.join(_VALUES)} to replace, got {', '.join(sorted(unknown))}")
    if found.rig is not None and (found.raw or not found.values):
        return _raw(found, found.rig, replace)
    if found.rig is not None and "baseline" in replace:  # cameras in one place tell no direction
        found.rig = found.rig.with_baseline(replace["baseline"]) if found.rig.baseline > 0 else None
    values = {**found.values, **replace}
    lacking = [name for name in ("focal", "baseline") if name not in values]
    lacking += [name for name in found.lacking if name not in values and name not in lacking]
    if lacking:
        fields = " and ".join(found.lacking.get(name, name) for name in lacking)
        options = " and ".join(f"--{name}" for name in lacking)
        it = "it" if len(lacking) == 1 else "them"
        raise AnyNetError(f"the calibration lacks {fields}: give {options}, or add {it} to the file")
    return _rectified(found, values)


def _rectified(found: Found, values: Mapping[str, float]) -> Calibration:
    return Calibration(**values, size=found.size, ndisp=found.ndisp, origin=found.origin, rig=found.rig)


def _raw(found: Found, rig: StereoRig, replace: Mapping[str, float]) -> StereoRig:
    if set(replace) - {"baseline"}:
        names = ", ".join(f"--{name}" for name in replace)
        raise AnyNetError(f"the calibration is of raw cameras: {names} cannot replace values of rectified ones")
    rig.check_skew()
    values = {**found.values, **replace}
    if {"focal", "baseline"} <= values.keys():  # told beside the raw cameras
        rig = rig.with_rectified(_rectified(found, values))
    if "baseline" in replace:
        return rig.with_baseline(replace["baseline"])
    return rig
