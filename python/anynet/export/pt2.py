"""`torch.export`: the deployed network's graph with our operators in it."""

from __future__ import annotations

import io
from pathlib import Path

import torch

from anynet.errors import AnyNetError
from anynet.export.network import Request, trace
from anynet.io.files import write_atomically


def export_pt2(request: Request, path: Path) -> None:
    """Writes the program; whoever loads it with `torch.export.load` has to import `anynet_ext` first.

    Raises:
        AnyNetError: as of `trace`, or for a name without .pt2 at its end.
    """
    check_name(path)
    program = trace(request)
    buffer = io.BytesIO()  # PyTorch, writing the file itself, aborts the process where the disk is full
    torch.export.save(program, buffer)
    write_atomically(path, buffer.getvalue())


def check_name(path: Path) -> None:
    """PyTorch insists on it."""
    if path.suffix != ".pt2":
        raise AnyNetError(f"{path.name}: expected a name that ends in .pt2")
