"""AOTInductor: a package of compiled models, one for all stages and one for each."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor
from torch._inductor.exc import CppCompileError, InductorError, InvalidCxxCompiler
from torch._inductor.package.package import package_aoti
from torch.export.pt2_archive._package import AOTI_FILES
from torch.export.pt2_archive._package_weights import Weights

from anynet.errors import AnyNetError, one_line
from anynet.export.cut import Part, cut, run, whole
from anynet.export.network import INPUTS, Request, check_one_size, outputs, trace
from anynet.export.pt2 import check_name
from anynet.io.files import write_atomically

WHOLE = "model"


def export_aoti(request: Request, path: Path) -> None:
    """Compiles the network into a package of several models.

    "model" computes all stages' disparities from the two images. "stage_1", "stage_2" ... compute one each: their
    inputs are the images and outputs of the stages before, and the first output is the disparity. Every model's
    metadata has the names of its "inputs" and "outputs", separated by spaces, and "height" and "width" of the images.

    Raises:
        AnyNetError: as of `trace`, for `dynamic`, or if there is no working C++ compiler.
    """
    check_one_size(request, "aoti")
    check_name(path)
    program = trace(request)
    names = outputs(len(program.graph_signature.user_outputs))
    images = {name: torch.zeros(request.height, request.width, 3, dtype=torch.uint8) for name in INPUTS}
    stages = cut(program, names)
    with torch.no_grad():
        values = run(stages, images)
        models = {WHOLE: whole(program, names)} | {f"stage_{k}": part for k, part in enumerate(stages, 1)}
        files: AOTI_FILES = {name: _compiled(part, values, request) for name, part in models.items()}
    buffer = io.BytesIO()  # as in `export_pt2`
    package_aoti(buffer, files)
    write_atomically(path, buffer.getvalue())


def _compiled(part: Part, values: Mapping[str, Tensor], request: Request) -> list[str | Weights]:
    """The files of a compiled part, for inputs like these values."""
    metadata = {
        "inputs": " ".join(part.inputs),
        "outputs": " ".join(part.outputs),
        "height": str(request.height),
        "width": str(request.width),
    }
    options = {
        "aot_inductor.package": True,
        "aot_inductor.metadata": metadata,
        "cpp.dynamic_threads": True,  # as many as the program that loads it says
    }
    arguments = tuple(values[name] for name in part.inputs)
    try:
        files: list[str | Weights] = torch._inductor.aot_compile(part.module, arguments, options=options)  # type: ignore[assignment]
    except RuntimeError as error:
        cause = error.inner_exception if isinstance(error, InductorError) else error
        if not isinstance(cause, (CppCompileError, InvalidCxxCompiler)):
            raise
        raise AnyNetError(f"export: the C++ compiler failed: {one_line(cause)}") from None
    return files
