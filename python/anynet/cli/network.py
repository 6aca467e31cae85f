"""The options of how the network computes, as several commands have them."""

from __future__ import annotations

from typing import Annotated

import typer

from anynet.scheduler import MAX_THREADS

Weights = Annotated[str, typer.Option(help="A packaged name, or a path: our .safetensors, an official .tar.")]
InputScale = Annotated[
    float | None,
    typer.Option(
        help="Work on the images resized by this factor: above 1 finer and slower, below 1 for very large ones.",
        show_default="the weights'",
    ),
]
BudgetMs = Annotated[
    float | None, typer.Option(min=0, help="Stop a pair after the last stage that fits into this time.")
]
Stage = Annotated[int | None, typer.Option(min=1, help="Stop after this stage.")]
Device = Annotated[
    str, typer.Option(help="Where to compute: cpu; cuda or cuda:N, a GPU; auto: the first GPU, if there is one.")
]
Precision = Annotated[
    str, typer.Option(help="In what a GPU computes convolutions: float32, bfloat16 or float16; the rest is float32.")
]
Threads = Annotated[int | None, typer.Option(min=1, max=MAX_THREADS, help="CPU threads.", show_default="torch's")]
