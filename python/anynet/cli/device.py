"""The options where and how to compute, as several commands have them."""

from __future__ import annotations

from typing import Annotated

import typer

Device = Annotated[
    str, typer.Option(help="Where to compute: cpu; cuda or cuda:N, a GPU; auto: the first GPU, if there is one.")
]
Precision = Annotated[
    str, typer.Option(help="In what a GPU computes convolutions: float32, bfloat16 or float16; the rest is float32.")
]
