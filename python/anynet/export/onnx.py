"""ONNX: the operators written out in the standard's own, the scans as `Scan`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.export import ExportedProgram

from anynet.errors import AnyNetError
from anynet.export.network import INPUTS, Request, check_one_size, outputs, trace
from anynet.io.files import replacing
from anynet_ext import reference

OPSET = 18


def export_onnx(request: Request, path: Path) -> None:
    """Writes the network as ONNX of opset 18.

    Raises:
        AnyNetError: as of `trace`, for `dynamic`, or if the packages of the extra `export` are missing.
    """
    check_one_size(request, "onnx")
    translations()  # before minutes of work
    program = write_out(trace(request))
    save(program, path, INPUTS, outputs(len(program.graph_signature.user_outputs)))


def save(program: ExportedProgram, path: Path, input_names: Sequence[str], output_names: Sequence[str]) -> None:
    """Writes a program whose only operator of ours is `spatial_propagation`."""
    model = torch.onnx.export(
        program,
        input_names=input_names,
        output_names=output_names,
        opset_version=OPSET,
        custom_translation_table=translations(),
        verbose=False,
    )
    assert model is not None
    with replacing(path) as unfinished:
        model.save(unfinished, external_data=False)


def translations() -> dict[Callable[..., Any], Callable[..., Any]]:
    """How to say in ONNX what it has no operator for."""
    try:
        from anynet.export.scan import spatial_propagation
    except ImportError as error:
        raise AnyNetError(f"export: ONNX needs {error.name}: pip install 'anynet[export]'") from None
    return {torch.ops.anynet.spatial_propagation.default: spatial_propagation}


def write_out(program: ExportedProgram) -> ExportedProgram:
    """With the operators' references in the place of the operators, but for `spatial_propagation`."""
    targets = {node.target for node in program.graph.nodes if node.op == "call_function"}
    ours = {target for target in targets if getattr(target, "namespace", "") == "anynet"}
    ours.discard(torch.ops.anynet.spatial_propagation.default)
    table: dict[Any, Callable[..., Any]] = {operator: _reference(operator) for operator in ours}
    table[torch.ops.aten.cummin.default] = _cummin
    written: ExportedProgram = program.run_decompositions(table)
    return written


def _reference(operator: Any) -> Callable[..., Any]:
    """The operator's reference, whose scans remain an operator."""
    scans = operator.name() in ("anynet::fill_occlusions", "anynet::normalized_propagation")
    propagation = {"propagation": torch.ops.anynet.spatial_propagation.default} if scans else {}
    return partial(reference.of(operator), **propagation)


def _cummin(x: Tensor, dim: int) -> tuple[Tensor, Tensor]:
    """Of the last dimension, by doubling; ONNX has none. No indices: nobody asks for them."""
    assert dim in (-1, x.dim() - 1)
    step, length = 1, x.shape[-1]
    while step < length:
        x = torch.minimum(x, F.pad(x, (step, 0), value=torch.inf)[..., :length])
        step *= 2
    return x, torch.zeros_like(x, dtype=torch.long)
