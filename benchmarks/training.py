"""Times a training step on the CPU, forward and backward through all stages, against the same network on PyTorch.

python benchmarks/training.py [--threads 2] [--batch 6] [--size 256 512] [--rounds 8]

* ours: the network as it trains;
* PyTorch's convolutions: the same, but for its convolutions;
* PyTorch: the same on PyTorch's own operators, but for the propagation (column by column it takes minutes).
The three take turns; ratios are medians over the turns. The gradients that come in are given, as the loss is no part of
the network.

python benchmarks/training.py --device cuda [--weights paper] [--batch 12] [--size 256 512] [--rounds 8]

times whole steps of `anynet train` on a GPU: launch by launch, and captured as a CUDA graph.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path

import torch
from measure import CONVOLUTIONS, OPERATORS, PlainOperators, console, interleaved_ms, median_ratio, options
from rich.table import Table

from anynet import AnyNet
from anynet.training.distributed import Processes
from anynet.training.graphs import WARM_UP
from anynet.training.loop import _Run
from anynet.training.recipe import Recipe


def steps(batch: int, height: int, width: int) -> dict[str, Callable[[], None]]:
    """One forward and backward pass each, by what computes it."""
    torch.manual_seed(0)
    model = AnyNet().train()
    images = torch.randn(2, batch, 3, height, width)
    gradients = list(torch.randn(model.config.stages, batch, 1, height, width))

    def ours() -> None:
        torch.autograd.backward(model(*images), gradients)

    def without(names: tuple[str, ...]) -> None:
        with PlainOperators(names):
            ours()

    return {
        "ours": ours,
        "PyTorch's convolutions": lambda: without(CONVOLUTIONS),
        "PyTorch": lambda: without(tuple(name for name in OPERATORS if name != "spatial_propagation")),
    }


def steps_on_gpu(weights: str, batch: int, height: int, width: int) -> dict[str, Callable[[], None]]:
    """One step of training each, from the packaged weights."""
    recipe = Recipe(weights=weights, steps=10**6, learning_rate=1e-6, ema_decay=0.99)
    device = torch.device("cuda")
    with tempfile.TemporaryDirectory() as folder:
        run = _Run(recipe, Path(folder), [], {}, Processes(0, 1, device))
    images = torch.randint(0, 256, (2, batch, 3, height, width), dtype=torch.uint8, device=device)
    disparity = torch.rand(batch, 1, height, width, device=device) * 60
    tensors = [*images, disparity, torch.ones_like(disparity)]
    for _ in range(WARM_UP + 1):
        run._update(tensors)

    def timed(step: Callable[[list[torch.Tensor]], torch.Tensor]) -> Callable[[], None]:
        def call() -> None:
            step(tensors)
            torch.cuda.synchronize()

        return call

    return {"captured": timed(run._update), "launch by launch": timed(run._computed)}


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--weights", default="paper", help="on a GPU: whose network")
    parser.add_argument("--batch", type=int, default=6)
    parser.add_argument("--size", type=int, nargs=2, default=(256, 512), metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--rounds", type=int, default=8)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    size = arguments.batch, *arguments.size
    if arguments.device == "cuda":
        calls, title = steps_on_gpu(arguments.weights, *size), f"{torch.cuda.get_device_name()}, {arguments.weights}"
    else:
        calls, title = steps(*size), f"{arguments.threads} thread(s)"
    times = interleaved_ms(calls, arguments.rounds, slow=float("inf"))
    first = next(iter(times))
    table = Table("", "ms", f"against {first}", title=f"{title}, batch {arguments.batch}")
    for name, each in times.items():
        table.add_row(name, f"{statistics.median(each):.1f}", f"{median_ratio(each, times[first]):.2f} x")
    console().print(table)


if __name__ == "__main__":
    main()
