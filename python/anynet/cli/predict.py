"""`anynet predict`: disparity, depth and point clouds from pairs of images."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from anynet.cli.calibration import UNKNOWN, CameraOptions, with_cameras
from anynet.cli.network import BudgetMs, Device, InputScale, Precision, Stage, Threads, Weights
from anynet.cli.pairs import Pair, find_pairs, share_of
from anynet.cli.results import DepthFiles, DepthFormat, DisparityFile, Format, Writer, file_ids
from anynet.cli.told import collected_warnings, tell, tell_warnings, warnings_first
from anynet.cli.trust import Confidence, DropOccluded, LeftRight, MaxDepth, MinConfidence
from anynet.errors import AnyNetError
from anynet.io.files import make_folder
from anynet.json_text import json_text

if TYPE_CHECKING:
    from anynet import Estimate, Predictor
    from anynet.camera import PairPreparation, PreparedPair
    from anynet.trust import Trust


@dataclass(frozen=True)
class Request:
    """What to do with every pair."""

    prepare: PairPreparation
    writer: Writer
    budget_ms: float | None
    stage: int | None
    all_stages: bool
    save_rectified: bool
    told: list[str]
    """Warnings about the calibration, which are those of every pair."""
    trust: Trust
    asked: dict[str, Any]
    """Of every estimate beside the disparity."""


@with_cameras
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
    weights: Weights = "default",
    input_scale: InputScale = None,
    budget_ms: BudgetMs = None,
    stage: Stage = None,
    format: DisparityFile = None,
    depth_format: DepthFiles = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N", help="Only every N-th pair, from the I-th on: for N processes or machines, I from 1 to N."
        ),
    ] = None,
    all_stages: Annotated[bool, typer.Option("--all-stages", help="Write the earlier stages too.")] = False,
    cameras: CameraOptions = UNKNOWN,
    save_rectified: Annotated[
        bool,
        typer.Option(
            "--save-rectified", help="Write the rectified images too, as NAME_rectified_left and NAME_rectified_right."
        ),
    ] = False,
    max_depth: MaxDepth = None,
    confidence: Confidence = False,
    left_right: LeftRight = False,
    min_confidence: MinConfidence = 0.0,
    drop_occluded: DropOccluded = False,
    device: Device = "cpu",
    precision: Precision = "float32",
    threads: Threads = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object per pair and line, for machines.")
    ] = False,
) -> None:
    """Disparity, depth and point clouds from pairs of images.

    Writes NAME_disparity (pixels) and NAME_color.png into the folder OUT and, with a calibration, NAME_depth (meters,
    or millimeters in a PNG) and NAME_cloud.ply; asked for, NAME_confidence.png (white: sure) and NAME_occluded.png
    (white: not seen by the right camera). NAME is that of the left image. Raw images are rectified if the
    calibration is of raw cameras; the results are then in the rectified left view. NaN, in a PNG 0, is unknown.
    """
    if all_stages and budget_ms is not None:
        raise AnyNetError("--all-stages and --budget-ms exclude each other")
    pairs, alone = find_pairs(left, right)
    share = pairs if shard is None else share_of(pairs, shard)
    if len(share) < len(pairs) and share[:1] != pairs[:1]:
        alone = []  # the first share tells

    from anynet.trust import Trust

    with warnings_first() as told:
        calibration = cameras.read(pairs[0].left, _size(pairs[0].left) if cameras.calib else None)
        if calibration is None and (depth_format or max_depth is not None):
            raise AnyNetError(
                "--depth-format and --max-depth belong to a calibration (--calib, or --focal and --baseline)"
            )
        prepare = cameras.preparation(calibration, input_scale)
    inputs = file_ids(path for pair in pairs for path in (pair.left, pair.right))
    writer = Writer(out, format or Format.png, tuple(depth_format or [DepthFormat.tiff]), max_depth, inputs)
    trust = Trust(min_confidence, drop_occluded)
    asked = {"confidence": confidence or left_right or trust.asked, "left_right": left_right}
    request = Request(prepare, writer, budget_ms, stage, all_stages, save_rectified, told, trust, asked)
    for path in alone:
        tell(f"{path}: no image of this name in the other folder")
    make_folder(out)

    from anynet import Predictor  # takes seconds, so after the cheap checks

    predictor = Predictor(weights, device=device, precision=precision, threads=threads, input_scale=input_scale)
    if stage is not None and stage > predictor.config.stages:
        raise AnyNetError(f"expected --stage from 1 to {predictor.config.stages}, got {stage}")
    failed = 0
    for pair in _progress(share):
        try:
            report = _process(pair, predictor, request)
        except AnyNetError as error:
            if as_json:
                print(json_text({"name": pair.name, "error": str(error)}), flush=True)
            if len(pairs) == 1:
                raise
            failed += 1
            tell(f"{pair.name}: {error}")
            continue
        tell_warnings([warning for warning in report["warnings"] if warning not in told], pair.name)
        if as_json:
            print(json_text(report), flush=True)
        else:
            _print(report, files=len(pairs) == 1)
    if failed or alone:
        raise AnyNetError(f"{failed} of {len(share)} pairs failed, {len(alone)} images have no partner")


def _process(pair: Pair, predictor: Predictor, request: Request) -> dict[str, Any]:
    """Computes and writes everything for one pair; returns what `--json` prints."""
    from anynet.io import read_pair
    from anynet.visualize import limits_of

    with collected_warnings() as told:
        images = read_pair(pair.left, pair.right)
        prepared = request.prepare(*images)
        estimates = _estimates(predictor, prepared, request)
        last = estimates[-1]
        disparity = prepared.known(request.trust.kept(last))
        results = request.writer.of(pair.name)
        for estimate in estimates[:-1] if request.all_stages else []:
            results.write_disparity(
                f"stage{estimate.stage}_", prepared.known(request.trust.kept(estimate)), limits_of(disparity)
            )
        results.write_disparity("", disparity, limits_of(disparity))
        results.write_trust(last)
        if prepared.calibration is not None:
            results.write_depth(disparity, prepared.calibration, prepared.left)
        if request.save_rectified:
            results.write_images(prepared.left, prepared.right)
        results.tell_older()
    calibration = prepared.calibration
    notes = [] if calibration is None or not calibration.origin else [f"calibration: {calibration.origin}"]
    return {
        "name": pair.name,
        "left": str(pair.left),
        "right": str(pair.right),
        "width": prepared.left.shape[1],
        "height": prepared.left.shape[0],
        "stage": last.stage,
        "stages": [estimate.stage for estimate in estimates],
        "elapsed_ms": [round(estimate.elapsed_ms, 3) for estimate in estimates],
        "calibration": None if calibration is None else calibration.values(),
        "files": results.files,
        "warnings": list(dict.fromkeys([*request.told, *prepared.warnings, *told])),
        "notes": [*notes, *prepared.notes],
    }


def _estimates(predictor: Predictor, pair: PreparedPair, request: Request) -> list[Estimate]:
    fitting = pair.predictor(predictor)
    if request.budget_ms is not None:
        return [fitting.predict(pair.left, pair.right, request.budget_ms, request.stage, **request.asked)]
    estimates = []
    for estimate in fitting.stages(pair.left, pair.right, **request.asked):
        estimates.append(estimate)
        if estimate.stage == request.stage:
            break
    return estimates


def _size(image: Path) -> tuple[int, int] | None:
    """Width and height of an image as it is used; None if it cannot be read, which is told where it is read."""
    from anynet.io import read_image

    try:
        with collected_warnings():  # told where it is read for good
            height, width = read_image(image).shape[:2]
    except AnyNetError:
        return None
    return width, height


def _progress(pairs: list[Pair]) -> Iterator[Pair]:
    """The pairs one by one, with a bar on the terminal if there are several."""
    if len(pairs) == 1:
        yield from pairs
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    console = Console(stderr=True)
    with Progress(
        *columns,
        console=console,
        redirect_stdout=sys.stdout.isatty(),  # results in a file or pipe stay there
        transient=True,
        disable=not console.is_terminal,
    ) as progress:
        yield from progress.track(pairs)


def _print(report: dict[str, Any], files: bool) -> None:
    times = ", ".join(f"{milliseconds:.1f}" for milliseconds in report["elapsed_ms"])
    print(f"{report['name']}: {report['width']} x {report['height']}, stage {report['stage']} after {times} ms")
    if files:
        for line in (*report["notes"], *report["files"].values()):
            print(f"  {line}")
