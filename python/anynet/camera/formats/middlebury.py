"""Middlebury's and ETH3D's `calib.txt`: cam0, cam1, doffs, baseline (millimeters), width, height, ndisp.

Source: https://vision.middlebury.edu/stereo/data/scenes2014/ ("Calibration file format").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Request, camera_values, from_values
from anynet.camera.tree import numbers
from anynet.errors import AnyNetError


def recognizes(documents: Sequence[Document]) -> bool:
    (document,) = documents
    return document.kind == "ini" and ("cam0" in document.fields or {"baseline", "doffs"} <= set(document.fields))


def read(documents: Sequence[Document], request: Request) -> Found:
    fields = documents[0].fields
    found = Found("Middlebury")
    single = {
        name: float(numbers(fields[name], name, 1)[0])
        for name in ("baseline", "doffs", "width", "height", "ndisp")
        if name in fields
    }
    cameras = {name: numbers(fields[name], name, 9).reshape(3, 3) for name in ("cam0", "cam1") if name in fields}
    values = {name: camera_values(camera, name) for name, camera in cameras.items()}
    if len(values) == 2:
        from_values(found, values["cam0"], values["cam1"])
    elif "cam0" in values:
        found.values = values["cam0"]
    else:
        found.lacking["focal"] = "cam0"
    if "baseline" in single:
        found.values["baseline"] = single["baseline"] * (request.meters or 1e-3)
    else:
        found.lacking["baseline"] = "baseline"
    told = found.values.get("doffs")
    if "doffs" in single:
        found.values["doffs"] = single["doffs"]
        if told is not None and abs(told - single["doffs"]) > 0.5:
            found.warnings.append(f"doffs is {single['doffs']:g}, but the cx of cam1 minus that of cam0 is {told:g}")
    elif told is None:
        found.lacking["doffs"] = "doffs"
    if not all(np.isfinite(value) and abs(value) < 1e9 for name, value in single.items() if name != "baseline"):
        raise AnyNetError("expected doffs, width, height and ndisp to be finite numbers")
    if "width" in single and "height" in single:
        found.size = int(single["width"]), int(single["height"])
    if single.get("ndisp", 0) > 0:
        found.ndisp = int(single["ndisp"])
    return found
