"""Times the network and the CUDA operators on a GPU, or estimates them from what they move and multiply.

python benchmarks/gpu.py              # on a GPU: ours, PyTorch eager, torch.compile, TensorRT; GB/s beside a copy
python benchmarks/gpu.py --estimate   # anywhere: the tables of docs/cuda.md
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice, product
from math import ceil
from time import perf_counter
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile
from torch.utils._python_dispatch import TorchDispatchMode

import anynet_ext
from anynet_ext import reference

if TYPE_CHECKING:
    from anynet.model.deploy import StageResult

# From the makers' data sheets: bytes per second, and float32 multiply-adds per second.
BANDWIDTH = {"H100": 3350e9, "RTX 4090": 1008e9, "Orin": 205e9}
MULTIPLY_ADDS = {"H100": 33.5e12, "RTX 4090": 41.3e12, "Orin": 2.65e12}
HEAD_START = 1_000_000  # cycles: half a millisecond
GAP = 2e-6  # seconds from one kernel of a CUDA graph to the next: assumed
FLOAT = 4
KITTI = (375, 1242)
NETWORKS = ("paper", "default", "large")


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


def deployed(name: str, shape: str, make: Callable[[], tuple[Any, ...]], passes: float = 1) -> Workload:
    """An operator of the deployed network. `passes`: how often its kernel reads the tensors that it is given."""

    def ours(*args: Any) -> object:
        return getattr(anynet_ext, name)(*args)

    def eager(*args: Any) -> object:
        return getattr(reference, name)(*args)

    with torch.device("meta"):
        args = make()
        inputs = sum(t.nbytes for t in torch.utils._pytree.tree_leaves(args) if isinstance(t, Tensor))
        out = getattr(reference, name)(*args).nbytes
    return Workload(name, shape, inputs + out, int(passes * inputs) + out, make, ours, eager)


def deployed_workloads() -> list[Workload]:
    """The deployed network's calls on KITTI's images of 375x1242 pixels, with the packaged weights."""

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape)

    def image() -> Tensor:
        return torch.zeros((*KITTI, 3), dtype=torch.uint8)

    def stem(c: int) -> tuple[Any, ...]:
        first = normal(3), normal(c, 3, 3, 3), normal(c)
        return image(), image(), *first, normal(c, c, 3, 3), normal(c), normal(c)

    halo = (17 * 67) / (16 * 64)
    return [
        deployed("stem", "C=1, 375x1242", lambda: stem(1), halo),
        deployed("read_image", "factor 4", lambda: (image(), normal(3), normal(3), 4, 96, 312)),
        deployed(
            "refinement_guide", "factor 4, 94x311",
            lambda: (image(), image(), normal(1, 1, 94, 311), normal(3), normal(3), 4),
        ),
        deployed("max_pool", "C=2, 96x312", lambda: (normal(2, 2, 96, 312), normal(2), normal(2))),
        deployed(
            "upsample_sum", "3 maps to 375x1242",
            lambda: ([normal(24, 78), normal(48, 156), normal(96, 312)], [16, 8, 4], *KITTI),
        ),
        deployed(
            "upsample_concat", "4 + 8, 48x156",
            lambda: (normal(2, 4, 48, 156), normal(2, 8, 24, 78), normal(12), normal(12)),
        ),
        deployed("upsample_add", "C=16, 24x47x156",
                 lambda: (normal(1, 16, 24, 47, 156), normal(1, 16, 12, 24, 78), normal(16), normal(16))),
        deployed("cost_volume_affine_relu", "C=8, K=12, 24x78",
                 lambda: (normal(1, 8, 24, 78), normal(1, 8, 24, 78), None, 0, 11, normal(1), normal(1))),
        deployed("conv3x3", "16 to 24, 96x312", lambda: (normal(1, 16, 96, 312), normal(24, 16, 3, 3)),
                 3 * (6 * 34) / (4 * 32)),
        deployed("conv3x3x3", "16 to 16, 12x24x78", lambda: (normal(1, 16, 12, 24, 78), normal(16, 16, 3, 3, 3)),
                 2 * 3 * (6 * 34) / (4 * 32)),
        deployed(
            "conv_chain", "4 to 4 to 4, 5x96x312",
            lambda: (normal(1, 4, 5, 96, 312), [normal(4, 4, 3, 3, 3)] * 2, [normal(4)] * 2),
            (12 * 20) / (8 * 16),
        ),
        deployed("fill_occlusions", "96x312", lambda: (normal(1, 1, 96, 312), 4.0)),
        deployed(
            "normalized_propagation", "C=8, 96x312", lambda: (normal(1, 8, 96, 312), normal(1, 3, 8, 96, 312), 0)
        ),
        deployed("candidate_costs", "C=8, 4 groups, 188x621",
                 lambda: (normal(2, 8, 188, 621), normal(1, 1, 188, 621), 4, -2, 2, 2)),
        deployed("expected_disparity", "7, 188x621",
                 lambda: (normal(1, 7, 188, 621), normal(1, 1, 188, 621), normal(1, 2, 188, 621), -2), 2),
        deployed("convex_upsampling", "188x621", lambda: (normal(1, 1, 188, 621), normal(1, 32, 188, 621))),
    ]  # fmt: skip


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


def milliseconds(call: Callable[[], object], *, ahead: bool = False) -> float:
    """Median of 50 calls, or as many as a second holds, each between two events; the cache is overwritten between.

    Args:
        ahead: the GPU waits until the host has launched the call (or HEAD_START is over): the kernels' time alone.
    """
    flush = torch.empty(64 << 20, dtype=torch.int8, device="cuda")
    times: list[float] = []
    start = perf_counter()
    for i in range(60):
        slow = perf_counter() - start > 1
        if slow and times:
            break
        flush.zero_()
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        if ahead:
            torch.cuda._sleep(HEAD_START)
        begin.record()
        call()
        end.record()
        end.synchronize()
        if i >= 10 or slow:
            times.append(begin.elapsed_time(end))
    return statistics.median(times)


def launches(call: Callable[[], object]) -> int:
    """Kernels that a call runs on the GPU; copies are none."""
    call()
    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CUDA]) as profiler:
        call()
        torch.cuda.synchronize()
    names = [event.name for event in profiler.events() if event.device_type == torch.autograd.DeviceType.CUDA]
    return sum(not name.startswith(("Memcpy", "Memset")) for name in names)


def network_table(weights: str, stages: int) -> Callable[..., None]:
    """Prints a table's head; the function prints a row: milliseconds until each stage, and launches until the last."""
    print(f"\n{weights}, {KITTI[0]}x{KITTI[1]}\n")
    print(f"| | batch | | {' | '.join(f'stage {s} ms' for s in range(1, stages + 1))} | launches |")
    print("| --- | --: | --- |" + " --: |" * (stages + 1))

    def row(name: str, batch: int, dtype: str, to_stage: Callable[[int], object], *, first: int = 1) -> None:
        try:
            times = " | ".join(
                "-" if stage < first else f"{milliseconds(lambda: to_stage(stage)):.3f}"  # noqa: B023
                for stage in range(1, stages + 1)
            )
            print(f"| {name} | {batch} | {dtype} | {times} | {launches(lambda: to_stage(stages))} |", flush=True)
        except Exception as error:  # say so and go on
            print(f"| {name} | {batch} | {dtype} | {type(error).__name__}: {str(error).splitlines()[0]} |", flush=True)

    return row


def measure_network(weights: str) -> None:
    """Milliseconds until each stage's disparity is there at the images' size, everything on the GPU; ours and eager."""
    from anynet import load_checkpoint
    from anynet.device import PRECISIONS
    from anynet.model.deploy import DeployedAnyNet
    from anynet.model.graphs import GraphedAnyNet

    model = load_checkpoint(weights).cuda().eval()
    networks = {name: DeployedAnyNet(model, dtype) for name, dtype in PRECISIONS.items()}
    left, right = (torch.randint(0, 256, (*KITTI, 3), dtype=torch.uint8, device="cuda") for _ in range(2))
    row = network_table(weights, model.config.stages)

    def pairs(steps: Callable[[Tensor, Tensor], Iterator[StageResult]], batch: int) -> Callable[[int], None]:
        def to_stage(stage: int) -> None:
            for _ in range(batch):
                *_, result = islice(steps(left, right), stage)
                result()

        return to_stage

    with torch.inference_mode():
        for batch in (1, 8):
            for name, network in networks.items():
                row("ours", batch, name, pairs(GraphedAnyNet(network).stages, batch))
            row("ours without graphs", batch, "float32", pairs(networks["float32"].stages, batch))
    for batch, dtype in product((1, 8), ("float32", "bfloat16")):
        row("PyTorch eager", batch, dtype, training_form(model, batch, dtype))


def training_form(forward: Callable[..., object], batch: int, dtype: str) -> Callable[[int], None]:
    """The network as it trains, on normalized images, until a stage."""
    images = [torch.randn(batch, 3, *KITTI, device="cuda") for _ in range(2)]

    def to_stage(stage: int) -> None:
        with torch.no_grad(), torch.autocast("cuda", torch.bfloat16, enabled=dtype == "bfloat16"):
            forward(*images, stage)

    return to_stage


def measure_compiled(weights: str, until: float) -> None:
    """Milliseconds until the last stage of what takes minutes to compile."""
    from anynet import load_checkpoint

    model = load_checkpoint(weights).cuda().eval()
    compiled = {"torch.compile, max-autotune": torch.compile(model, mode="max-autotune", dynamic=False)}
    if find_spec("torch_tensorrt") is not None:
        import torch_tensorrt  # noqa: F401  (registers the backend)

        compiled["TensorRT"] = torch.compile(model, backend="torch_tensorrt", dynamic=False)
    row = network_table(weights, model.config.stages)
    for batch, dtype, (name, forward) in product((1, 8), ("float32", "bfloat16"), compiled.items()):
        if perf_counter() > until:
            print(f"| {name} | {batch} | {dtype} | not measured: --seconds are over |")
        else:
            row(name, batch, dtype, training_form(forward, batch, dtype), first=model.config.stages)


def measure(seconds: float) -> None:
    """First what is ours; last what may take minutes to compile."""
    torch.manual_seed(0)
    until = perf_counter() + seconds
    print(f"\n{torch.cuda.get_device_name()}, torch {torch.__version__}")
    for weights in NETWORKS:
        measure_network(weights)
    measure_operators(until)
    for weights in NETWORKS:
        measure_compiled(weights, until)


def measure_operators(until: float) -> None:
    source = torch.empty(256 << 20, dtype=torch.int8, device="cuda")
    target = torch.empty_like(source)
    copy = 2 * source.numel() / milliseconds(lambda: target.copy_(source)) / 1e6
    print(f"\nA copy of 256 MiB: {copy:.0f} GB/s\n")
    print("| operator | size | ms | GB/s | of a copy | eager ms | torch.compile ms |")
    print("| --- | --- | --: | --: | --: | --: | --: |")
    for work in [*workloads(), *deployed_workloads()]:
        with torch.device("cuda"):
            inputs = work.make()
        ours = milliseconds(lambda: work.ours(*inputs), ahead=True)  # noqa: B023
        eager = milliseconds(lambda: work.eager(*inputs), ahead=True)  # noqa: B023
        compiled = "-"
        unrolled = any(part in work.name for part in ("propagation", "occlusions"))  # a scan, column by column
        if not unrolled and "backward" not in work.name and perf_counter() < until:
            function = torch.compile(work.eager, dynamic=False)
            compiled = f"{milliseconds(lambda: function(*inputs), ahead=True):.4f}"  # noqa: B023
        speed = work.fewest / ours / 1e6
        print(
            f"| {work.name} | {work.shape} | {ours:.4f} | {speed:.0f} | {speed / copy:.0%} "
            f"| {eager:.4f} | {compiled} |",
            flush=True,
        )


class Work(TorchDispatchMode):
    """Adds up what the operators of a network move and multiply: every tensor read once and written once."""

    def __init__(self) -> None:
        super().__init__()
        self.launches = self.bytes = self.multiply_adds = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        results = func._schema.returns
        view = all(r.alias_info is not None and not r.alias_info.is_write for r in results)
        if view or "empty" in func._opname:
            return out
        self.launches += 1
        tensors = [t for t in torch.utils._pytree.tree_leaves([args, out]) if isinstance(t, Tensor)]
        self.bytes += sum(t.nbytes for t in tensors)
        weights = [t for t in tensors[:-1] if t.dim() >= 4 and t.shape[-1] == 3]
        if func._opname == "conv_chain":  # two layers in a launch; what goes from one launch to the next
            between = [weight.shape[0] for weight in weights[1:-1:2]]
            self.launches += len(between)
            self.bytes += 2 * sum(between) * out[0, 0].nbytes
        if "conv" in func._opname and weights:
            self.multiply_adds += sum(w[0].numel() * w.shape[0] for w in weights) * out[0, 0].numel()
        elif func._opname == "stem":
            first, second = weights
            self.multiply_adds += 2 * KITTI[0] * KITTI[1] * (first.numel() + second.numel() / 4)
        return out


def estimate_network(weights: str) -> None:
    from anynet import load_checkpoint
    from anynet.model.deploy import DeployedAnyNet

    network = DeployedAnyNet(load_checkpoint(weights), torch.float32)
    images = [torch.zeros((*KITTI, 3), dtype=torch.uint8) for _ in range(2)]
    print(f"\n{weights}, {KITTI[0]}x{KITTI[1]}\n")
    print(f"| stage | operators | MB | GMAC | {' | '.join(f'{gpu} µs' for gpu in BANDWIDTH)} |")
    print("| --- | --: | --: | --: |" + " --: |" * len(BANDWIDTH))

    def row(name: str, work: Work) -> None:
        seconds = [
            max(work.bytes / BANDWIDTH[gpu], work.multiply_adds / MULTIPLY_ADDS[gpu]) + GAP * work.launches
            for gpu in BANDWIDTH
        ]
        times = " | ".join(f"{1e6 * each:.0f}" for each in seconds)
        print(f"| {name} | {work.launches} | {work.bytes / 1e6:.1f} | {work.multiply_adds / 1e9:.3f} | {times} |")

    total = Work()
    with torch.inference_mode():
        steps = network.stages(*images)
        for stage in range(1, network.config.stages + 1):
            with Work() as work:
                result = next(steps)
            row(str(stage), work)
            for name in ("launches", "bytes", "multiply_adds"):
                setattr(total, name, getattr(total, name) + getattr(work, name))
        with Work() as work:
            result()
        row("at the images' size", work)
    for name in ("launches", "bytes", "multiply_adds"):
        setattr(total, name, getattr(total, name) + getattr(work, name))
    row("all", total)


def estimate() -> None:
    for weights in NETWORKS:
        estimate_network(weights)
    print()
    print(f"| operator | size | fewest MB | as coded MB | {' | '.join(f'{gpu} µs' for gpu in BANDWIDTH)} |")
    print("| --- | --- | --: | --: |" + " --: |" * len(BANDWIDTH))
    for work in [*workloads(), *deployed_workloads()]:
        times = " | ".join(f"{work.coded / speed * 1e6:.1f}" for speed in BANDWIDTH.values())
        print(f"| {work.name} | {work.shape} | {work.fewest / 1e6:.2f} | {work.coded / 1e6:.2f} | {times} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--estimate", action="store_true", help="no GPU: bytes moved, and the time that follows from it"
    )
    parser.add_argument("--seconds", type=float, default=math.inf, help="compile nothing more after that")
    arguments = parser.parse_args()
    if arguments.estimate:
        estimate()
    elif torch.cuda.is_available():
        measure(arguments.seconds)
    else:
        print("no GPU: nothing measured (--estimate prints what to expect)")
