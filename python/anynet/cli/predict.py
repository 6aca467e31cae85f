"""`anynet predict`: disparity, depth and point clouds from pairs of images."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from anynet.cli.pairs import Pair, find_pairs
from anynet.errors import AnyNetError
from anynet.io.files import make_folder

if TYPE_CHECKING:
    from anynet import Estimate, Predictor
    from anynet.io import Calibration


class Format(str, Enum):
    """Formats of disparity files."""

    png = "png"
    pfm = "pfm"
    npy = "npy"


@dataclass(frozen=True)
class Request:
    """What to do with every pair."""

    out: Path
    format: Format
    budget_ms: float | None
    stage: int | None
    all_stages: bool
    check: bool
    calibration: Calibration | None
    max_depth: float


def predict(
    left: Annotated[
        str, typer.Argument(metavar="LEFT", help="Left image, folder of left images, or quoted glob pattern.")
    ],
    right: Annotated[
        str,
        typer.Argument(
            metavar="RIGHT",
            help="The right image or images: of the same file names in the other folder, or in the same sorted order.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results; made if missing.")],
    weights: Annotated[
        str, typer.Option(help="A packaged name, or a path: our .safetensors, an official .tar.")
    ] = "default",
    input_scale: Annotated[
        float | None,
        typer.Option(
            help="Work on the images resized by this factor: above 1 finer and slower, below 1 for very large ones.",
            show_default="the weights'",
        ),
    ] = None,
    budget_ms: Annotated[
        float | None, typer.Option(min=0, help="Stop after the last stage that fits into this time.")
    ] = None,
    stage: Annotated[int | None, typer.Option(min=1, help="Stop after this stage.")] = None,
    format: Annotated[Format, typer.Option(help="Disparity files: 16-bit PNG as KITTI's, PFM, or NumPy.")] = Format.png,
    all_stages: Annotated[bool, typer.Option("--all-stages", help="Write the earlier stages too.")] = False,
    calib: Annotated[
        Path | None,
        typer.Option(
            help="Calibration of KITTI, Middlebury (calib.txt) or OpenCV (YAML, in metres): for depth and a cloud."
        ),
    ] = None,
    focal: Annotated[
        float | None,
        typer.Option(
            help="Focal length, pixels. This and the next four give the calibration, or replace values of --calib."
        ),
    ] = None,
    baseline: Annotated[float | None, typer.Option(help="Distance between the cameras, metres.")] = None,
    cx: Annotated[float | None, typer.Option(help="Principal point, pixels.", show_default="the centre")] = None,
    cy: Annotated[float | None, typer.Option(help="Principal point, pixels.", show_default="the centre")] = None,
    doffs: Annotated[
        float | None, typer.Option(help="cx of the right camera minus cx of the left.", show_default="0")
    ] = None,
    max_depth: Annotated[
        float, typer.Option(help="Leave farther points (metres) out of the cloud.", show_default="none")
    ] = float("inf"),
    threads: Annotated[int | None, typer.Option(min=1, help="CPU threads.", show_default="torch's")] = None,
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Warn if a pair looks unrectified or swapped.")
    ] = True,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object per pair and line, for machines.")
    ] = False,
) -> None:
    """Disparity, depth and point clouds from pairs of images.

    Writes NAME_disparity (pixels) and NAME_colour.png into the folder OUT and, with a calibration, NAME_depth.tiff
    (32-bit float, metres, NaN where unknown) and NAME_cloud.ply. NAME is that of the left image.
    """
    if all_stages and budget_ms is not None:
        raise AnyNetError("--all-stages and --budget-ms exclude each other")
    pairs, alone = find_pairs(left, right)
    numbers = {"focal": focal, "baseline": baseline, "cx": cx, "cy": cy, "doffs": doffs}
    calibration = _calibration(calib, {name: value for name, value in numbers.items() if value is not None})
    request = Request(out, format, budget_ms, stage, all_stages, check, calibration, max_depth)
    for path in alone:
        print(f"anynet: {path}: no image of this name in the other folder", file=sys.stderr)
    make_folder(out)

    from anynet import Predictor  # takes seconds, so after the cheap checks

    predictor = Predictor(weights, threads=threads, input_scale=input_scale)
    if stage is not None and stage > predictor.config.stages:
        raise AnyNetError(f"expected --stage from 1 to {predictor.config.stages}, got {stage}")
    failed = 0
    for pair in _progress(pairs):
        try:
            report = _process(pair, predictor, request)
        except AnyNetError as error:
            if len(pairs) == 1:
                raise
            failed += 1
            report = {"name": pair.name, "error": str(error)}
            print(f"anynet: {pair.name}: {error}", file=sys.stderr)
        for warning in report.get("warnings", []):
            print(f"anynet: {pair.name}: warning: {warning}", file=sys.stderr)
        if as_json:
            print(json.dumps(report), flush=True)
        elif "error" not in report:
            _print(report, files=len(pairs) == 1)
    if failed or alone:
        raise AnyNetError(f"{failed} of {len(pairs)} pairs failed, {len(alone)} images have no partner")


def _process(pair: Pair, predictor: Predictor, request: Request) -> dict[str, Any]:
    """Computes and writes everything for one pair; returns what `--json` prints."""
    from anynet.io import read_pair, write_depth, write_disparity, write_image, write_ply
    from anynet.rectification import check_rectified
    from anynet.visualize import disparity_image, limits_of

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        left, right = read_pair(pair.left, pair.right)
    findings = [str(warning.message) for warning in caught]
    height, width = left.shape[:2]
    calibration = request.calibration
    if calibration is not None and calibration.size and calibration.size != (width, height):
        expected = " x ".join(map(str, calibration.size))
        raise AnyNetError(f"expected images of {expected} as the calibration says, got {width} x {height}")
    if request.check:
        findings += check_rectified(left, right)

    estimates = _estimates(predictor, left, right, request)
    last = estimates[-1]
    limits = limits_of(last.disparity)
    files: dict[str, str] = {}

    def path(kind: str, ending: str) -> Path:
        files[kind] = str(request.out / f"{pair.name}_{kind}.{ending}")
        return Path(files[kind])

    for estimate in estimates if request.all_stages else [last]:
        prefix = "" if estimate is last else f"stage{estimate.stage}_"
        write_disparity(path(f"{prefix}disparity", request.format.value), estimate.disparity)
        write_image(path(f"{prefix}colour", "png"), disparity_image(estimate.disparity, limits))
    if calibration is not None:
        depth = calibration.depth(last.disparity)
        write_depth(path("depth", "tiff"), depth)
        near = depth <= request.max_depth
        write_ply(path("cloud", "ply"), calibration.points(depth)[near], left[near])
    return {
        "name": pair.name,
        "left": str(pair.left),
        "right": str(pair.right),
        "width": width,
        "height": height,
        "stage": last.stage,
        "elapsed_ms": [round(estimate.elapsed_ms, 3) for estimate in estimates],
        "calibration": None if calibration is None else asdict(calibration),
        "files": files,
        "warnings": findings,
    }


def _estimates(predictor: Predictor, left: Any, right: Any, request: Request) -> list[Estimate]:
    if request.budget_ms is not None:
        return [predictor.predict(left, right, budget_ms=request.budget_ms, stage=request.stage)]
    estimates = []
    for estimate in predictor.stages(left, right):
        estimates.append(estimate)
        if estimate.stage == request.stage:
            break
    return estimates


def _calibration(file: Path | None, numbers: dict[str, Any]) -> Calibration | None:
    """From a file, from numbers, or from both."""
    from anynet.io import Calibration, read_calibration

    if file is not None:
        return replace(read_calibration(file), **numbers)
    if not numbers:
        return None
    missing = [f"--{name}" for name in ("focal", "baseline") if name not in numbers]
    if missing:
        raise AnyNetError(f"the calibration lacks {' and '.join(missing)}")
    return Calibration(**numbers)


def _progress(pairs: list[Pair]) -> Iterator[Pair]:
    """The pairs one by one, with a bar on the terminal if there are several."""
    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    console = Console(stderr=True)
    with Progress(
        *columns,
        console=console,
        redirect_stdout=sys.stdout.isatty(),  # results in a file or pipe stay there
        transient=True,
        disable=len(pairs) == 1 or not console.is_terminal,
    ) as progress:
        yield from progress.track(pairs)


def _print(report: dict[str, Any], files: bool) -> None:
    times = ", ".join(f"{milliseconds:.1f}" for milliseconds in report["elapsed_ms"])
    print(f"{report['name']}: {report['width']} x {report['height']}, stage {report['stage']} after {times} ms")
    if files:
        for file in report["files"].values():
            print(f"  {file}")
