"""Times a training step on the CPU, forward and backward through all stages, against the same network on PyTorch.

python benchmarks/training.py [--threads 2] [--batch 6] [--size 256 512] [--rounds 8]

* ours: the network as it trains;
* PyTorch's convolutions: the same, but for its convolutions;
* PyTorch: the same on PyTorch's own operators, but for the propagation (column by column it takes minutes).
The three take turns; ratios are medians over the turns. The gradients that come in are given, as the loss is no part of
the network.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable

import torch
from measure import CONVOLUTIONS, OPERATORS, PlainOperators, console, interleaved_ms, median_ratio, options
from rich.table import Table

from anynet import AnyNet


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


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--batch", type=int, default=6)
    parser.add_argument("--size", type=int, nargs=2, default=(256, 512), metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--rounds", type=int, default=8)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    times = interleaved_ms(steps(arguments.batch, *arguments.size), arguments.rounds, slow=float("inf"))
    table = Table("", "ms", "against ours", title=f"{arguments.threads} thread(s), batch {arguments.batch}")
    for name, each in times.items():
        table.add_row(name, f"{statistics.median(each):.0f}", f"{median_ratio(each, times['ours']):.2f} x")
    console().print(table)


if __name__ == "__main__":
    main()
