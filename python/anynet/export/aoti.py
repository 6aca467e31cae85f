"""AOTInductor: a package of compiled models, one for all stages and one for each."""

from __future__ import annotations

from pathlib import Path

import torch

from anynet.errors import AnyNetError, one_line
from anynet.export.cut import Part, cut, run, whole
from anynet.export.network import INPUTS, Request, outputs, trace
from anynet.export.pt2 import check_name

WHOLE = "model"


def export_aoti(request: Request, path: Path) -> None:
    """Compiles the network into a package of several models.

    "model" computes all stages' disparities from the two images. "stage_1", "stage_2" ... compute one each; the inputs
    and outputs of every model are listed by name in its metadata, under "inputs" and "outputs", separated by spaces. A
    stage's inputs are the images and outputs of the stages before; its first output is the disparity.

    Raises:
        AnyNetError: as of `trace`, for `dynamic`, or if there is no working C++ compiler.
    """
    if request.dynamic:
        raise AnyNetError("export: expected images of one size for aoti, got --dynamic: a package is made for a size")
    check_name(path)
    program = trace(request)
    names = outputs(len(program.graph_signature.user_outputs))
    images = {name: torch.zeros(request.height, request.width, 3, dtype=torch.uint8) for name in INPUTS}
    stages = cut(program, names)
    with torch.no_grad():
        values = run(stages, images)
        models = {WHOLE: whole(program, names)} | {f"stage_{k}": part for k, part in enumerate(stages, 1)}
        files = {name: _compiled(part, [values[i] for i in part.inputs]) for name, part in models.items()}
    torch._inductor.package.package_aoti(str(path), files)


def _compiled(part: Part, arguments: list[torch.Tensor]) -> list[str]:
    """The files of a compiled part."""
    options = {
        "aot_inductor.package": True,
        "aot_inductor.metadata": {"inputs": " ".join(part.inputs), "outputs": " ".join(part.outputs)},
        "cpp.dynamic_threads": True,  # as many as the program that loads it says
    }
    try:
        return torch._inductor.aot_compile(part.module, tuple(arguments), options=options)
    except torch._inductor.exc.CppCompileError as error:
        raise AnyNetError(f"export: the C++ compiler failed: {one_line(error)}") from None
