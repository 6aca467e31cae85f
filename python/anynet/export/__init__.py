"""The network in other runtimes' formats: ONNX, `torch.export`, AOTInductor (docs/export.md).

Each has two inputs, `left` and `right`, uint8 RGB [H, W, 3], and an output per stage, `disparity_1` ..., float32
[H, W].
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from anynet.errors import AnyNetError

if TYPE_CHECKING:
    from anynet.export.network import Request

FORMATS = ("onnx", "pt2", "aoti")


def export_as(format: str, request: Request, path: str | os.PathLike[str]) -> None:
    """Writes the network in one of `FORMATS`; whole, or not at all.

    Raises:
        AnyNetError: if there is no such format, the request cannot be met, what the format needs is not installed, or
            the file cannot be written.
    """
    if format not in FORMATS:
        raise AnyNetError(f"export: expected format {', '.join(FORMATS)}, got {format!r}")
    with _quiet():
        getattr(import_module(f"anynet.export.{format}"), f"export_{format}")(request, Path(path))


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what PyTorch's exporters say about themselves."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
