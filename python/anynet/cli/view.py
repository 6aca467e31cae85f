"""`anynet view`: a page to look at disparity, confidence and cloud, live."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from anynet.cli.calibration import UNKNOWN, CameraOptions, with_cameras
from anynet.cli.network import Device, InputScale, Precision, Threads
from anynet.cli.sources import Rate, Reconnect, Size, Slop, Split, Topic, Topics, open_source
from anynet.cli.stopping import stopping

if TYPE_CHECKING:
    from anynet.camera import PairPreparation
    from anynet.streams import Source

Host = Annotated[str, typer.Option(help="Where the page listens; 0.0.0.0: for other machines too.")]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Of the page; the next free one is taken.")]


@with_cameras
def view(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help="Left image, or a source as of `anynet stream`.")],
    right: Annotated[str | None, typer.Argument(metavar="[RIGHT]", help="The right images.")] = None,
    split: Split = False,
    rate: Rate = None,
    size: Size = None,
    topics: Topics = None,
    topic: Topic = None,
    slop: Slop = None,
    reconnect: Reconnect = None,
    weights: Annotated[str, typer.Option(help="Chosen at first: a packaged name, or a path.")] = "default",
    input_scale: InputScale = None,
    cameras: CameraOptions = UNKNOWN,
    out: Annotated[Path, typer.Option(help="Folder of what the page's button saves.")] = Path("anynet-view"),
    host: Host = "127.0.0.1",
    port: Port = 8080,
    device: Device = "cpu",
    precision: Precision = "float32",
    threads: Threads = None,
) -> None:
    """A page in the browser: images, confidence and cloud, and a slider for the time that a frame may take.

    Needs viser: pip install 'anynet[view]'. Ctrl-C ends it.
    """
    with open_source(
        source, right, split=split, rate=rate, size=size, topics=topics, topic=topic, slop=slop, reconnect=reconnect
    ) as opened:
        prepare, _ = cameras.for_source(source, opened, input_scale)
        show(
            opened, prepare, weights, input_scale, device, precision, threads, out, host, port,
            rate=rate, watch=cameras.check,
        )  # fmt: skip


def show(
    source: Source,
    prepare: PairPreparation,
    weights: str,
    input_scale: float | None,
    device: str,
    precision: str,
    threads: int | None,
    out: Path,
    host: str = "127.0.0.1",
    port: int = 8080,
    rate: float | None = None,
    watch: bool = True,
) -> None:
    """Serves the page until Ctrl-C or SIGTERM."""
    from anynet.checkpoint import PACKAGED
    from anynet.view import View

    names = [file.stem for file in sorted(PACKAGED.glob("*.safetensors"))]
    view = View(
        source, prepare=prepare, weights=list(dict.fromkeys([weights, *names])), input_scale=input_scale,
        device=device, precision=precision, threads=threads, host=host, port=port, out=out, rate=rate, watch=watch,
    )  # fmt: skip

    with stopping(view.stop):
        print(f"{view.url} (Ctrl-C ends it)", flush=True)
        view.run()
