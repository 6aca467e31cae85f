"""Numbers without names: FoundationStereo's `K.txt`, the nine numbers of a camera matrix and the baseline in meters."""

from __future__ import annotations

from collections.abc import Sequence

from anynet.camera.document import Document
from anynet.camera.formats.found import Found, Request, camera_values
from anynet.camera.tree import numbers
from anynet.errors import AnyNetError


def recognizes(documents: Sequence[Document]) -> bool:
    (document,) = documents
    return document.kind == "numbers" and numbers(document.tree, "the file").size in (9, 10)


def read(documents: Sequence[Document], request: Request) -> Found:
    values = numbers(documents[0].tree, "the file")
    matrix = values[:9].reshape(3, 3)
    if list(matrix[2]) != [0, 0, 1]:
        raise AnyNetError("expected nine numbers of a camera matrix, whose last row is 0 0 1, and the baseline")
    found = Found("camera matrix and baseline", camera_values(matrix))
    if values.size == 10:
        found.values["baseline"] = float(values[9]) * (request.meters or 1.0)
    else:
        found.lacking["baseline"] = "the baseline as its tenth number"
    return found
