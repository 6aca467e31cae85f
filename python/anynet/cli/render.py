"""`anynet render`: stereo pairs with exact ground truth, made on this machine."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer


def render(
    out: Annotated[Path, typer.Option(help="Folder for the pairs; those already there are kept.")],
    count: Annotated[int, typer.Option(min=1, max=10**7, help="Number of pairs.")] = 3000,
    seed: Annotated[int, typer.Option(min=0, max=2**62, help="Seed of the first pair; each next one adds 1.")] = 0,
    height: Annotated[int, typer.Option(min=64, max=16384, help="Pixels.")] = 384,
    width: Annotated[int, typer.Option(min=64, max=16384, help="Pixels.")] = 768,
    workers: Annotated[int | None, typer.Option(min=1, max=1024, help="Processes; by default one per core.")] = None,
) -> None:
    """Renders random stereo pairs with exact disparity and occlusion of both views, for `anynet train`."""
    from rich.progress import track

    from anynet.data.rendered import write_rendered

    steps = write_rendered(out, count, seed, height, width, workers or len(os.sched_getaffinity(0)))
    first = next(steps)
    for _ in track(steps, "rendering", total=count - first):
        pass
    typer.echo(f"{out}: {count} pairs of {width} x {height}")
