"""What half precision on a GPU costs in accuracy, computed on the CPU: D1 per stage, in %, means over the images.

python benchmarks/precision.py DATA... [--weights paper default large] [--pairs 20] [--threads 2]

DATA is KIND:ROOT[?OPTION=VALUE&...] (docs/data.md). The graph is the one that `Predictor(device="cuda", precision=...)`
runs, of which only the convolutions in half precision are not the CPU's own: their inputs, weights and results are
rounded to that type, and their sums are float32, as those of a GPU are.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from measure import console, options
from rich.table import Table
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from anynet import Estimate, load_checkpoint
from anynet.data import open_datasets
from anynet.evaluation.evaluate import Image, Method, compare
from anynet.model.deploy import DeployedAnyNet

PRECISIONS = torch.float32, torch.bfloat16, torch.float16


class HalfConvolutions(TorchDispatchMode):
    """Convolutions in half precision, by our own of float32: products of half types are exact in it."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func._opname not in ("conv2d", "conv3d") or args[0].dtype == torch.float32:
            return func(*args, **(kwargs or {}))
        x, weight, bias, (stride, *_) = args[:4]
        wide = [None if t is None else t.float().contiguous() for t in (x, weight, bias)]
        op = torch.ops.anynet.conv3x3 if weight.dim() == 4 else torch.ops.anynet.conv3x3x3
        return op(*wide, stride=stride).to(x.dtype)


def method(weights: str, precision: torch.dtype) -> Method:
    network = DeployedAnyNet(load_checkpoint(weights), precision)

    def stages(left: Image, right: Image) -> Iterator[Estimate]:
        images: list[Tensor] = [torch.from_numpy(image).contiguous() for image in (left, right)]
        with torch.inference_mode(), HalfConvolutions():
            for stage, enlarge in enumerate(network.stages(*images), 1):
                yield Estimate(stage, enlarge().numpy(), 0.0)

    return stages


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("data", nargs="+")
    parser.add_argument("--weights", nargs="+", default=["paper", "default", "large"])
    parser.add_argument("--pairs", type=int, help="of each data set, evenly spread; default: all")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    table = Table("data", "pairs", "weights", *(str(precision).removeprefix("torch.") for precision in PRECISIONS))
    for spec in arguments.data:
        samples: Any = open_datasets([spec])
        if arguments.pairs is not None:
            samples = [samples[i * len(samples) // arguments.pairs] for i in range(min(arguments.pairs, len(samples)))]
        for weights in arguments.weights:
            results = compare({str(precision): method(weights, precision) for precision in PRECISIONS}, samples)
            cells = [" / ".join(f"{stage.mean.d1:.2f}" for stage in each.stages) for each in results.values()]
            table.add_row(spec, str(len(samples)), weights, *cells)
    console().print(table)


if __name__ == "__main__":
    main()
