"""`anynet export`: the network for other runtimes."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from anynet.io.files import check_output


class Format(str, Enum):
    onnx = "onnx"
    pt2 = "pt2"
    aoti = "aoti"


def export(
    format: Annotated[
        Format,
        typer.Option(
            help="onnx, for onnxruntime, OpenVINO and TensorRT; pt2, a program of torch.export; aoti, a package of "
            "machine code made by AOTInductor, for C++ without Python."
        ),
    ],
    height: Annotated[int, typer.Option(min=1, help="Height of the images, in pixels.")],
    width: Annotated[int, typer.Option(min=1, help="Width of the images, in pixels.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The file to write; its folder is made if missing.")],
    weights: Annotated[str, typer.Option(help="A packaged name, or a path.")] = "default",
    stages: Annotated[int | None, typer.Option(min=1, help="How many of the first stages.", show_default="all")] = None,
    dynamic: Annotated[bool, typer.Option("--dynamic", help="For images of any size; pt2 alone.")] = False,
) -> None:
    """The network for other runtimes.

    Inputs are left and right, uint8 RGB [H, W, 3]; outputs are disparity_1, disparity_2 ..., float32 [H, W], in pixels.
    """
    from anynet.export import export_as
    from anynet.export.network import Request

    check_output(out)
    export_as(format.value, Request(weights, height, width, stages, dynamic), out)
    print(out)
