"""The network in other runtimes' formats: ONNX, `torch.export`, AOTInductor (docs/export.md).

Each has two inputs, `left` and `right`, uint8 RGB [H, W, 3], and an output per stage, `disparity_1` ..., float32
[H, W].
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from anynet.export.network import Request

FORMATS = ("onnx", "pt2", "aoti")


def export_as(format: str, request: Request, path: Path) -> None:
    """Writes the network in one of `FORMATS`.

    Raises:
        AnyNetError: if the request cannot be met, or what the format needs is not installed.
    """
    getattr(import_module(f"anynet.export.{format}"), f"export_{format}")(request, path)
