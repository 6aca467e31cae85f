"""Options about confidence, as several commands have them."""

from __future__ import annotations

from typing import Annotated

import typer

from anynet.errors import AnyNetError


def _positive(depth: float | None) -> float | None:
    if depth is not None and not depth > 0:
        raise AnyNetError(f"expected --max-depth > 0, got {depth:g}")
    return depth


Confidence = Annotated[
    bool, typer.Option("--confidence", help="How likely every pixel is right, and what the right camera does not see.")
]
LeftRight = Annotated[
    bool, typer.Option("--left-right", help="Judge that by the right view's disparity too: twice the time.")
]
MinConfidence = Annotated[float, typer.Option(min=0, max=1, help="Disparities less likely to be right become unknown.")]
DropOccluded = Annotated[
    bool,
    typer.Option(
        "--drop-occluded", help="What the right camera does not see becomes unknown, and blurred edges with it."
    ),
]
MaxDepth = Annotated[
    float | None,
    typer.Option(
        help="Leave farther points (meters) out of the cloud; inf: none.",
        callback=_positive,
        show_default="the depth at which half a pixel of error is 20 %",
    ),
]
