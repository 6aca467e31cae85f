"""The network's convolutions, one by one, against PyTorch's and against the processor's multiply-add peak.

    python benchmarks/conv.py [--train] [--threads 1 2]

Each line: our time, GFLOP/s and share of the peak, that of a loop of nothing but multiply-adds in this run; PyTorch's
best of plain eager and channels_last (where batch and layout allow it, oneDNN). With --train also our gradients of the
input and of the weights.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
import torch.nn.functional as F
from measure import PRODUCT, matrix_product, median_ms, multiply_adds, options

import anynet_ext

# batch, channels in and out, size, stride, how many such layers; a 1232 x 368 pair as the network sees it
FRAME = [
    (2, 3, 1, (368, 1232), 1, 1),
    (2, 1, 1, (368, 1232), 2, 1),
    (2, 1, 2, (184, 616), 1, 1),
    (2, 2, 2, (184, 616), 1, 1),
    (2, 2, 4, (92, 308), 1, 1),
    (2, 4, 4, (92, 308), 1, 1),
    (2, 4, 8, (46, 154), 1, 1),
    (2, 8, 8, (46, 154), 1, 1),
    (1, 1, 16, (12, 23, 77), 1, 1),
    (1, 16, 16, (12, 23, 77), 1, 4),
    (1, 16, 1, (12, 23, 77), 1, 1),
    (2, 12, 4, (46, 154), 1, 1),
    (1, 1, 4, (5, 46, 154), 1, 1),
    (1, 4, 4, (5, 46, 154), 1, 4),
    (1, 4, 1, (5, 46, 154), 1, 1),
    (2, 6, 2, (92, 308), 1, 1),
    (1, 1, 4, (5, 92, 308), 1, 1),
    (1, 4, 4, (5, 92, 308), 1, 4),
    (1, 4, 1, (5, 92, 308), 1, 1),
    (1, 3, 16, (92, 308), 1, 1),
    (1, 16, 16, (92, 308), 1, 2),
    (1, 16, 24, (92, 308), 1, 1),
    (1, 1, 8, (92, 308), 1, 1),
    (1, 8, 1, (92, 308), 1, 1),
]
# batch 6 of 256 x 512 crops
TRAIN = [
    (12, 3, 1, (256, 512), 1, 1),
    (12, 1, 1, (256, 512), 2, 1),
    (12, 2, 2, (128, 256), 1, 1),
    (12, 4, 4, (64, 128), 1, 1),
    (12, 8, 8, (32, 64), 1, 1),
    (6, 1, 16, (12, 16, 32), 1, 1),
    (6, 16, 16, (12, 16, 32), 1, 4),
    (6, 16, 1, (12, 16, 32), 1, 1),
    (6, 4, 4, (5, 32, 64), 1, 4),
    (6, 1, 4, (5, 64, 128), 1, 1),
    (6, 4, 4, (5, 64, 128), 1, 4),
    (6, 4, 1, (5, 64, 128), 1, 1),
    (6, 16, 16, (64, 128), 1, 2),
    (6, 16, 24, (64, 128), 1, 1),
]


def seconds_of(run: Callable[..., object], *args: object) -> float:
    """Median seconds per call, over 30 ms of calls."""
    return median_ms(lambda: run(*args), 0.03) / 1000


def main() -> None:
    parser = options(__doc__, threads=None)
    parser.add_argument("--train", action="store_true")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, torch.get_num_threads()])
    arguments = parser.parse_args()
    for threads in dict.fromkeys(arguments.threads):
        torch.set_num_threads(threads)
        loop = multiply_adds(threads)
        limit, product = 2 * loop() / seconds_of(loop), 2 * PRODUCT / seconds_of(matrix_product())
        print(f"\n{threads} threads, GFLOP/s: peak {limit / 1e9:.0f}, matrix product {product / 1e9:.0f}")
        totals: dict[str, float] = {}
        for batch, channels, out_channels, size, stride, count in TRAIN if arguments.train else FRAME:
            name = f"conv3x3{'x3' * (len(size) - 2)}"
            ours, plain = (anynet_ext.conv3x3, F.conv2d) if len(size) == 2 else (anynet_ext.conv3x3x3, F.conv3d)
            layout = torch.channels_last if len(size) == 2 else torch.channels_last_3d
            x = torch.rand(batch, channels, *size)
            w = torch.rand(out_channels, channels, *[3] * len(size))
            x_last, w_last = x.contiguous(memory_format=layout), w.contiguous(memory_format=layout)
            with torch.inference_mode():
                out = ours(x, w, stride=stride)
                times = {"ours": seconds_of(partial(ours, stride=stride), x, w)}
                if arguments.train:
                    operators = torch.ops.anynet
                    backward_input = getattr(operators, f"{name}_backward_input")
                    backward_weight = getattr(operators, f"{name}_backward_weight")
                    times["input"] = seconds_of(backward_input, out, w, None, list(x.shape), stride)
                    times["weight"] = seconds_of(backward_weight, out, x, None, None, stride, False)
                else:
                    times["torch"] = seconds_of(plain, x, w, None, stride, 1)
                    times["torch last"] = seconds_of(plain, x_last, w_last, None, stride, 1)
            flops = 2 * out.numel() * channels * 3 ** len(size)
            line = (
                f"{count}x {name:9} {batch:2}x{channels:2} ->{out_channels:3} {'x'.join(map(str, size)):10} /{stride}"
            )
            for key, seconds in times.items():
                totals[key] = totals.get(key, 0) + seconds * count
                share = f" {flops / seconds / 1e9:5.0f} GF/s {flops / seconds / limit:4.0%}"
                line += f" | {key} {seconds * 1e3:7.3f} ms{'' if key.startswith('torch') else share}"
            print(line)
        print("all layers, ms: " + ", ".join(f"{key} {seconds * 1e3:.2f}" for key, seconds in totals.items()))


if __name__ == "__main__":
    main()
