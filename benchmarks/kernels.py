"""Times the operators on the CPU against PyTorch eager, torch.compile and the limit of the machine.

python benchmarks/kernels.py [--threads 1 2] [--only NAME] [--json FILE]

Eager and compiled are `anynet_ext.reference` (PyTorch's own batch norm), float32; all times are medians of one call, in
milliseconds. Operators for inference have no backward pass; conv3x3 and conv3x3x3 are in conv.py. The limit is the
larger of arithmetic / peak rate and bytes / copy bandwidth, each input read and each output written once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from measure import Limits, console, measure_limits, median_ms, options, write_json
from rich.table import Table
from torch import Tensor

import anynet_ext
from anynet_ext import reference


@dataclass(frozen=True)
class Workload:
    """One operator at one size. `operations` and `backward_operations`: arithmetic per call, vector elements.

    Operators for inference have no backward operations.
    """

    name: str
    size: str
    inputs: tuple[Tensor, ...]
    ours: Callable[..., Tensor]
    plain: Callable[..., Tensor]
    operations: int
    backward_operations: int | None = None
    compiles: bool = True  # False where the plain version is a loop of hundreds of steps, too long a graph


def smooth_disparity(n: int, h: int, w: int) -> Tensor:
    """A slanted scene with depth edges: rows of surfaces 40 to 130 pixels wide, noise of a tenth of a pixel."""
    x, y = torch.arange(w), torch.arange(h)[:, None]
    surface = ((x + 3 * (y // 8)) // 90) % 5
    return (6.0 * surface + 0.01 * x + 0.1 * torch.randn(h, w)).expand(n, 1, h, w).contiguous()


def workloads() -> list[Workload]:
    torch.manual_seed(0)
    result = []

    c, h, w, k = 32, 96, 312, 48
    pixels = c * k * h * w
    result.append(
        Workload(
            "cost_volume",
            f"1x{c}x{h}x{w}, {k} disparities",
            (torch.randn(1, c, h, w), torch.randn(1, c, h, w)),
            lambda left, right: anynet_ext.cost_volume(left, right, None, 0, 47),
            lambda left, right: reference.cost_volume(left, right, None, 0, 47),
            3 * pixels,  # subtract, absolute, add
            4 * pixels,  # compare; add or subtract; for both sides
        )
    )
    c, h, w, k = 32, 184, 616, 5
    pixels = c * k * h * w
    result.append(
        Workload(
            "cost_volume around a map",
            f"1x{c}x{h}x{w}, {k} offsets",
            (torch.randn(1, c, h, w), torch.randn(1, c, h, w), smooth_disparity(1, h, w)),
            lambda left, right, d: anynet_ext.cost_volume(left, right, d, -2, 2),
            lambda left, right, d: reference.cost_volume(left, right, d, -2, 2),
            5 * pixels,  # multiply, multiply-add, subtract, absolute, add
            8 * pixels,
        )
    )
    c, h, w = 3, 375, 1242
    result.append(
        Workload(
            "warp",
            f"1x{c}x{h}x{w}",
            (torch.randn(1, c, h, w), smooth_disparity(1, h, w)),
            anynet_ext.warp,
            reference.warp,
            2 * c * h * w,
            6 * c * h * w,
        )
    )
    d, h, w = 192, 96, 312
    result.append(
        Workload(
            "soft_argmin",
            f"1x{d}x{h}x{w}",
            (4 * torch.randn(1, d, h, w),),
            lambda cost: anynet_ext.soft_argmin(cost, 0),
            lambda cost: reference.soft_argmin(cost, 0),
            16 * d * h * w,  # minimum, subtract, exp by a polynomial of degree 7, two sums
            19 * d * h * w,
        )
    )
    c, h, w = 8, 92, 308
    result.append(
        Workload(
            "spatial_propagation",
            f"1x{c}x{h}x{w}",
            (torch.randn(1, c, h, w), torch.rand(1, 3, c, h, w) / 3),
            lambda x, gates: anynet_ext.spatial_propagation(x, gates, 0),
            lambda x, gates: reference.spatial_propagation(x, gates, 0),
            7 * c * h * w,
            14 * c * h * w,
            compiles=False,
        )
    )
    n, c, h, w = 12, 1, 256, 512
    result.append(
        Workload(
            "batch_norm_relu",
            f"{n}x{c}x{h}x{w}",
            (torch.randn(n, c, h, w), torch.rand(c), torch.rand(c)),
            lambda x, weight, bias: anynet_ext.batch_norm_relu(x, weight, bias)[0],
            lambda x, weight, bias: F.relu(F.batch_norm(x, None, None, weight, bias, True)),
            6 * n * c * h * w,  # a sum; a difference, a square, a sum; a multiply-add, a maximum
            10 * n * c * h * w,
        )
    )
    n, c, h, w = 12, 4, 64, 128
    result.append(
        Workload(
            "resize",
            f"{n}x{c}x{h}x{w} to {4 * h}x{4 * w}",
            (torch.randn(n, c, h, w),),
            lambda x: anynet_ext.resize(x, (256, 512)),
            lambda x: reference.resize(x, (256, 512)),
            3 * 16 * n * c * h * w,  # along columns a multiply and a multiply-add; along rows less than one, shared
            3 * 16 * n * c * h * w,
        )
    )
    return result + inference_workloads()


def image(h: int, w: int) -> Tensor:
    return torch.randint(0, 256, (h, w, 3), dtype=torch.uint8)


def inference_workloads() -> list[Workload]:
    """Operators of the deployed network, at the sizes of a KITTI pair."""
    h, w = 92, 308  # 1/4 of 368 x 1232
    pixels = h * w

    def affine(c: int) -> tuple[Tensor, Tensor]:
        return torch.rand(c), torch.rand(c)

    def plain(function: Callable[..., Tensor], *rest: object) -> Callable[..., Tensor]:
        return lambda *tensors: function(*tensors, *rest)

    def row(name: str, size: str, inputs: tuple[Tensor, ...], operations: int, *rest: object) -> Workload:
        """A row whose operator and reference take the tensors, then the rest."""
        ours, reference_of = getattr(anynet_ext, name), getattr(reference, name)
        return Workload(name, size, inputs, plain(ours, *rest), plain(reference_of, *rest), operations)

    features, groups, span = torch.randn(2, 16, h, w), 2, (-2, 2)
    stem = (
        *(image(4 * h, 4 * w) for _ in range(2)),
        torch.rand(3),
        torch.randn(2, 3, 3, 3),
        torch.rand(2),
        torch.randn(2, 2, 3, 3),
        *affine(2),
    )
    volume = torch.randn(1, 8, 12, h // 4, w // 4), torch.randn(1, 8, 6, h // 8, w // 8)
    maps = [torch.randn(h >> i, w >> i) for i in (0, 1, 2)]
    weight, bias = torch.randn(4, 4, 3, 3, 3), torch.randn(4)
    return [
        Workload(
            "conv_chain",
            f"1x4 to 4 to 4x5x{h}x{w}",
            (torch.randn(1, 4, 5, h, w), weight, bias),
            lambda x, w, b: anynet_ext.conv_chain(x, [w, w], [b, b]),
            lambda x, w, b: reference.conv_chain(x, [w, w], [b, b]),
            2 * 432 * 5 * pixels,
        ),
        row("stem", f"2x{4 * h}x{4 * w}", stem, 2 * pixels * (16 * 54 + 4 * 36)),
        row(
            "read_image",
            f"{4 * h}x{4 * w} to {h}x{w}",
            (image(4 * h, 4 * w), torch.rand(3), torch.rand(3)),
            15 * pixels,
            4,
            h,
            w,
        ),
        row(
            "refinement_guide",
            f"2x{4 * h}x{4 * w} to {h}x{w}",
            (*(image(4 * h, 4 * w) for _ in range(2)), torch.rand(1, 1, h, w), torch.rand(3), torch.rand(3)),
            (45 + 3 * 4) * pixels,
            4,
        ),
        row("max_pool", f"2x16x{h}x{w}", (features, *affine(16)), 5 * 2 * 16 * pixels // 4),
        Workload(
            "upsample_sum",
            f"3 maps to {4 * h}x{4 * w}",
            tuple(maps),
            lambda *m: anynet_ext.upsample_sum(m, [4, 8, 16], 4 * h, 4 * w),
            lambda *m: reference.upsample_sum(m, [4, 8, 16], 4 * h, 4 * w),
            3 * 4 * 16 * pixels,
        ),
        row(
            "upsample_concat",
            f"2x16+16x{h}x{w}",
            (features, torch.randn(2, 16, h // 2, w // 2), *affine(32)),
            6 * 2 * 32 * pixels,
        ),
        row("upsample_add", f"1x8x12x{h // 4}x{w // 4}", (*volume, *affine(8)), 10 * volume[0].numel()),
        row(
            "cost_volume_affine_relu",
            f"1x16x{h // 4}x{w // 4}, 12 disparities",
            tuple(torch.randn(2, 1, 16, h // 4, w // 4)),
            3 * 16 * 12 * pixels // 16,
            None,
            0,
            11,
            *affine(1),
        ),
        row(
            "normalized_propagation",
            f"1x8x{h}x{w}",
            (torch.randn(1, 8, h, w), torch.randn(1, 3, 8, h, w)),
            13 * 8 * pixels,
            0,
        ),
        row("fill_occlusions", f"1x1x{h}x{w}", (smooth_disparity(1, h, w),), 16 * pixels, 1.0),
        row(
            "candidate_costs",
            f"2x16x{h}x{w}",
            (features, smooth_disparity(1, h, w)),
            (5 * 16 * (span[1] - span[0] + 3) + 12) * pixels,
            groups,
            *span,
            2,
        ),
        row(
            "expected_disparity",
            f"1x7x{h}x{w}",
            (torch.randn(1, 7, h, w), torch.rand(1, 1, h, w), torch.randn(1, 2, h, w)),
            16 * 7 * pixels,
            -2,
        ),
        row("convex_upsampling", f"1x1x{h}x{w}", (torch.rand(1, 1, h, w), torch.randn(1, 32, h, w)), 16 * 32 * pixels),
    ]


def backward_of(function: Callable[..., Tensor], inputs: tuple[Tensor, ...]) -> Callable[[], object]:
    """The backward pass of one call alone."""
    leaves = [t.detach().clone().requires_grad_() for t in inputs]
    out = function(*leaves)
    grad = torch.randn_like(out)
    return lambda: torch.autograd.grad(out, leaves, grad, retain_graph=True)


@dataclass(frozen=True)
class Row:
    """One line of the table; times in milliseconds."""

    kernel: str
    size: str
    threads: int
    ours: float
    eager: float
    compiled: float | None
    limit: float

    @property
    def speedup(self) -> float:
        return (self.compiled or self.eager) / self.ours


def measure(workload: Workload, limits: Limits, seconds: float) -> list[Row]:
    inputs = workload.inputs
    compiled = torch.compile(workload.plain) if workload.compiles else None
    with torch.no_grad():
        out = workload.ours(*inputs)
        forward = [
            None if f is None else median_ms(lambda f=f: f(*inputs), seconds) for f in _versions(workload, compiled)
        ]
    read, written = sum(t.nbytes for t in inputs), out.nbytes
    limit = limits.ms(workload.operations, read + written)
    rows = [Row(workload.name, workload.size, limits.threads, *forward, limit)]
    if workload.backward_operations is None:
        return rows
    backward = [
        None if f is None else median_ms(backward_of(f, inputs), seconds) for f in _versions(workload, compiled)
    ]
    back_limit = limits.ms(workload.backward_operations, 2 * read + written)
    return [*rows, Row(f"{workload.name}, backward", workload.size, limits.threads, *backward, back_limit)]


def _versions(workload: Workload, compiled: Callable[..., Tensor] | None) -> list[Callable[..., Tensor] | None]:
    return [workload.ours, workload.plain, compiled]


def table(rows: list[Row], limits: Limits) -> Table:
    title = f"{limits.threads} thread(s), ms; {limits}"
    result = Table(
        "kernel", "size", "ours", "eager", "compiled", "limit", "eager/ours", "compiled/ours", "ours/limit", title=title
    )
    for row in rows:
        compiled = ("-", "-") if row.compiled is None else (f"{row.compiled:.2f}", f"{row.compiled / row.ours:.1f}")
        result.add_row(
            row.kernel,
            row.size,
            f"{row.ours:.3f}",
            f"{row.eager:.2f}",
            compiled[0],
            f"{row.limit:.3f}",
            f"{row.eager / row.ours:.1f}",
            compiled[1],
            f"{row.ours / row.limit:.2f}",
        )
    return result


def main() -> None:
    parser = options(__doc__, threads=None)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--only", help="kernels whose name contains this")
    parser.add_argument("--seconds", type=float, default=0.5, help="how long to repeat each call")
    parser.add_argument("--json", type=Path, help="write the rows, the limits and the build here")
    arguments = parser.parse_args()
    out = console()
    all_rows: list[Row] = []
    all_limits: list[Limits] = []
    for threads in arguments.threads:
        limits = measure_limits(threads)
        torch._dynamo.reset()
        rows = [
            row
            for each in workloads()
            if (arguments.only or "") in each.name
            for row in measure(each, limits, arguments.seconds)
        ]
        out.print(table(rows, limits))
        backward = [row for row in rows if row.kernel.endswith(", backward")]
        for name, some in (("forward", [row for row in rows if row not in backward]), ("backward", backward)):
            if not some:
                continue
            mean = math.exp(sum(math.log(row.speedup) for row in some) / len(some))
            out.print(f"{name}: geometric mean {mean:.1f} x torch.compile (eager where it cannot compile)")
        all_rows += rows
        all_limits.append(limits)
    report = {
        "build": anynet_ext.build_info(),
        "limits": [asdict(limits) for limits in all_limits],
        "rows": [asdict(row) for row in all_rows],
    }
    write_json(arguments.json, report)


if __name__ == "__main__":
    main()
