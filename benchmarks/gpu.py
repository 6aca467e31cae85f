"""Times the CUDA operators on a GPU, or estimates them from the bytes they move.

python benchmarks/gpu.py              # on a GPU: ours, PyTorch eager, torch.compile, and GB/s beside a plain copy
python benchmarks/gpu.py --estimate   # anywhere: the table of docs/cuda.md
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import torch
from measure import options
from torch import Tensor

import anynet_ext
from anynet_ext import reference

BANDWIDTH = {"H100": 3350e9, "RTX 4090": 1008e9, "Orin": 205e9}  # bytes per second, from the makers' data sheets
FLOAT = 4


@dataclass(frozen=True)
class Workload:
    """One call in float32, N = 1. `fewest`: each input read and each output written once. `coded`: what the kernel's
    threads ask for beyond their block's cache; whatever of this the GPU's second-level cache serves is saved."""

    name: str
    shape: str
    fewest: int
    coded: int
    make: Callable[[], tuple[Tensor, ...]]
    ours: Callable[..., object]
    eager: Callable[..., object]


def _gradient(function: Callable[..., Tensor]) -> Callable[..., object]:
    """The backward pass of `function(*inputs)` alone, where the call's arguments are the inputs and the gradient."""
    saved: dict[int, tuple[Tensor, list[Tensor]]] = {}

    def run(*args: Tensor) -> object:
        *inputs, grad = args
        if id(grad) not in saved:
            leaves = [t.detach().requires_grad_() for t in inputs]
            saved[id(grad)] = function(*leaves), leaves
        out, leaves = saved[id(grad)]
        return torch.autograd.grad(out, leaves, grad, retain_graph=True)

    return run


def _normal(*shape: int, scale: float = 1) -> Tensor:
    return torch.randn(shape, device="cuda") * scale


def cost_volume(c: int, h: int, w: int, first: int, last: int, with_disparity: bool) -> list[Workload]:
    k, pixels = last - first + 1, h * w
    pair, out, disparity = 2 * c, k, 1 if with_disparity else 0
    fewest = FLOAT * pixels * (pair + out + disparity)
    groups = min(ceil(k / 8), 16)
    passes = ceil(k / 8 / groups)
    if with_disparity:
        coded = ceil(k / 8) * (pair + 1) + out
        backward = 2 * pair + 2 + 2 * out * ceil(c / 4) + pair
    else:
        coded = passes * (c + c * (128 + 8 * groups) / 128) + out
        backward = pair + pair * ceil(k / 64) * (128 + min(k, 64)) / 128 + 2 * out * ceil(c / 8) + pair

    def make() -> tuple[Tensor, ...]:
        smooth = torch.linspace(0, w / 8, w, device="cuda").expand(1, 1, h, w).contiguous()
        return _normal(1, c, h, w), _normal(1, c, h, w), *([smooth] if with_disparity else [])

    def ours(left: Tensor, right: Tensor, map: Tensor | None = None) -> Tensor:
        return anynet_ext.cost_volume(left, right, map, first, last)

    def eager(left: Tensor, right: Tensor, map: Tensor | None = None) -> Tensor:
        return reference.cost_volume(left, right, map, first, last)

    name, shape = "cost_volume" + (" around disparity" if with_disparity else ""), f"C={c}, K={k}, {h}x{w}"
    return [
        Workload(name, shape, fewest, int(FLOAT * pixels * coded), make, ours, eager),
        Workload(
            f"{name}, backward",
            shape,
            FLOAT * pixels * (2 * pair + out + 2 * disparity),
            int(FLOAT * pixels * backward),
            lambda: (*make(), _normal(1, k, h, w)),
            _gradient(ours),
            _gradient(eager),
        ),
    ]


def warp(c: int, h: int, w: int) -> list[Workload]:
    def make() -> tuple[Tensor, ...]:
        return _normal(1, c, h, w), torch.linspace(0, w / 8, w, device="cuda").expand(1, 1, h, w).contiguous()

    pixels, shape = h * w, f"C={c}, {h}x{w}"
    return [
        Workload(
            "warp",
            shape,
            FLOAT * pixels * (2 * c + 1),
            FLOAT * pixels * (2 * c + 1),
            make,
            anynet_ext.warp,
            reference.warp,
        ),
        Workload(
            "warp, backward",
            shape,
            FLOAT * pixels * (3 * c + 2),
            FLOAT * pixels * (4 * c + 2 + ceil(c / 4)),
            lambda: (*make(), _normal(1, c, h, w)),
            _gradient(anynet_ext.warp),
            _gradient(reference.warp),
        ),
    ]


def soft_argmin(d: int, h: int, w: int) -> list[Workload]:
    def ours(cost: Tensor) -> Tensor:
        return anynet_ext.soft_argmin(cost, 0)

    def eager(cost: Tensor) -> Tensor:
        return reference.soft_argmin(cost, 0)

    pixels, shape = h * w, f"D={d}, {h}x{w}"
    return [
        Workload(
            "soft_argmin",
            shape,
            FLOAT * pixels * (d + 1),
            FLOAT * pixels * (d + 1),
            lambda: (_normal(1, d, h, w),),
            ours,
            eager,
        ),
        Workload(
            "soft_argmin, backward",
            shape,
            FLOAT * pixels * (2 * d + 1),
            FLOAT * pixels * (3 * d + 1),
            lambda: (_normal(1, d, h, w), _normal(1, 1, h, w)),
            _gradient(ours),
            _gradient(eager),
        ),
    ]


def spatial_propagation(c: int, h: int, w: int, direction: int) -> list[Workload]:
    def ours(input: Tensor, gates: Tensor) -> Tensor:
        return anynet_ext.spatial_propagation(input, gates, direction)

    def eager(input: Tensor, gates: Tensor) -> Tensor:  # one step, several launches, per column: as the authors did
        return reference.spatial_propagation(input, gates, direction)

    def make() -> tuple[Tensor, ...]:
        return _normal(1, c, h, w), _normal(1, 3, c, h, w, scale=0.1)

    elements, name, shape = c * h * w, f"spatial_propagation, direction {direction}", f"C={c}, {h}x{w}"
    return [
        Workload(name, shape, FLOAT * elements * 5, FLOAT * elements * 5, make, ours, eager),
        Workload(
            f"{name}, backward",
            shape,
            FLOAT * elements * 10,
            FLOAT * elements * 10,
            lambda: (*make(), _normal(1, c, h, w)),
            _gradient(ours),
            _gradient(eager),
        ),
    ]


def workloads() -> list[Workload]:
    """AnyNet's own calls on KITTI (368x1232), then sizes of larger stereo networks."""
    return [
        *cost_volume(8, 23, 77, 0, 11, False),
        *cost_volume(4, 46, 154, -2, 2, True),
        *cost_volume(2, 92, 308, -2, 2, True),
        *warp(2, 92, 308),
        *soft_argmin(12, 23, 77),
        *soft_argmin(5, 92, 308),
        *spatial_propagation(8, 92, 308, 0),
        *cost_volume(32, 384, 1280, 0, 47, False),
        *cost_volume(32, 384, 1280, -2, 2, True),
        *warp(32, 384, 1280),
        *soft_argmin(48, 384, 1280),
        *spatial_propagation(8, 384, 1280, 0),
        *spatial_propagation(8, 384, 1280, 2),
    ]


def milliseconds(call: Callable[[], object]) -> float:
    """Median of 50 calls, each between two events; the cache is overwritten in between."""
    flush = torch.empty(64 << 20, dtype=torch.int8, device="cuda")
    times = []
    for i in range(60):
        flush.zero_()
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begin.record()
        call()
        end.record()
        end.synchronize()
        if i >= 10:
            times.append(begin.elapsed_time(end))
    return statistics.median(times)


def measure() -> None:
    torch.manual_seed(0)
    source = torch.empty(256 << 20, dtype=torch.int8, device="cuda")
    target = torch.empty_like(source)
    copy = 2 * source.numel() / milliseconds(lambda: target.copy_(source)) / 1e6
    print(f"{torch.cuda.get_device_name()}, torch {torch.__version__}; a copy of 256 MiB: {copy:.0f} GB/s\n")
    print("| operator | size | ms | GB/s | of a copy | eager ms | torch.compile ms |")
    print("| --- | --- | --: | --: | --: | --: | --: |")
    for work in workloads():
        inputs = work.make()
        ours = milliseconds(lambda: work.ours(*inputs))  # noqa: B023
        eager = milliseconds(lambda: work.eager(*inputs))  # noqa: B023
        compiled = "-"
        if "backward" not in work.name and "propagation" not in work.name:  # a compiled scan unrolls every column
            function = torch.compile(work.eager, dynamic=False)
            compiled = f"{milliseconds(lambda: function(*inputs)):.4f}"  # noqa: B023
        speed = work.fewest / ours / 1e6
        print(
            f"| {work.name} | {work.shape} | {ours:.4f} | {speed:.0f} | {speed / copy:.0%} | {eager:.4f} | {compiled} |"
        )


def estimate() -> None:
    print(f"| operator | size | fewest MB | as coded MB | {' | '.join(f'{gpu} µs' for gpu in BANDWIDTH)} |")
    print("| --- | --- | --: | --: |" + " --: |" * len(BANDWIDTH))
    for work in workloads():
        times = " | ".join(f"{work.coded / speed * 1e6:.1f}" for speed in BANDWIDTH.values())
        print(f"| {work.name} | {work.shape} | {work.fewest / 1e6:.2f} | {work.coded / 1e6:.2f} | {times} |")


if __name__ == "__main__":
    parser = options(__doc__, threads=None)
    parser.add_argument(
        "--estimate", action="store_true", help="no GPU: bytes moved, and the time that follows from it"
    )
    if parser.parse_args().estimate:
        estimate()
    elif torch.cuda.is_available():
        measure()
    else:
        print("no GPU: nothing measured (--estimate prints what to expect)")
