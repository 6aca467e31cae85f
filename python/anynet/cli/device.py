"""The option where to compute, as several commands have it."""

from __future__ import annotations

from typing import Annotated

import typer

Device = Annotated[
    str, typer.Option(help="Where to compute: cpu; cuda or cuda:N, a GPU; auto: the first GPU, if there is one.")
]
