"""`anynet evaluate`: error and time of networks and of OpenCV's matchers on data sets."""

from __future__ import annotations

import warnings
from enum import Enum
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from anynet.cli.calibration import UNKNOWN, CameraOptions, with_cameras
from anynet.cli.network import Device, InputScale, Precision, Threads
from anynet.cli.results import check_not_inputs, file_ids
from anynet.cli.told import telling_warnings
from anynet.cli.trust import LeftRight
from anynet.errors import AnyNetError
from anynet.json_text import json_text

if TYPE_CHECKING:
    from anynet import Predictor
    from anynet.camera import PairPreparation
    from anynet.samples import Dataset


class OpenCV(str, Enum):
    """Methods other than networks."""

    bm = "bm"
    sgbm = "sgbm"


class Region(str, Enum):
    """Pixels to count."""

    all = "all"
    noc = "noc"
    foreground = "foreground"
    background = "background"


@with_cameras
@telling_warnings
def evaluate(
    data: Annotated[
        list[str],
        typer.Option(
            help="Data to measure on, KIND:ROOT[?OPTION=VALUE&...], like kitti2015:DIR, folders:DIR?scale=4 (with "
            "left/, right/ and disparity/), csv:FILE?scale=1000&unit=mm (docs/data.md); repeatable."
        ),
    ],
    weights: Annotated[
        list[str] | None,
        typer.Option(help="Weights of any network, a packaged name or a file; repeatable. [default: default]"),
    ] = None,
    model: Annotated[
        list[str] | None,
        typer.Option(help="A baseline of anynet.baselines.MODELS with random weights, to time it; repeatable."),
    ] = None,
    input_scale: InputScale = None,
    method: Annotated[list[OpenCV] | None, typer.Option(help="OpenCV's matcher beside them; repeatable.")] = None,
    region: Annotated[list[Region] | None, typer.Option(help="Pixels to count; repeatable. [default: all]")] = None,
    confidence: Annotated[
        bool, typer.Option("--confidence", help="How good the confidences are, instead of the disparities.")
    ] = False,
    left_right: LeftRight = False,
    cameras: CameraOptions = UNKNOWN,
    perturb: Annotated[
        list[str] | None,
        typer.Option(
            help="Also with what real rigs do to images: rows1, rows2, roll, dark, jpeg, gamma, gain, blur, or all; "
            "repeatable."
        ),
    ] = None,
    splits: Annotated[
        bool, typer.Option("--splits", help="Each weights on its own data, in order: mean and deviation of the splits.")
    ] = False,
    device: Device = "cpu",
    precision: Precision = "float32",
    threads: Threads = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the tables, .md and .json, and, but for --perturb and --confidence, a figure per method "
            "and data set."
        ),
    ] = None,
) -> None:
    """Measure error and time, stage by stage.

    Pairs are rectified and checked as by `predict`, which is no part of the times. The truth of raw images is taken to
    be that of the rectified left view.
    """
    import cv2

    from anynet import Predictor
    from anynet.baselines import BaselinePredictor, random_baseline
    from anynet.data import open_dataset
    from anynet.data.files import PairFiles
    from anynet.evaluation import opencv, perturbed, report
    from anynet.evaluation.evaluate import Method, compare
    from anynet.evaluation.methods import open_method
    from anynet.evaluation.prepared import prepared
    from anynet.evaluation.truth import with_truth
    from anynet.io import write_image
    from anynet.io.files import make_folder

    if threads is not None:
        cv2.setNumThreads(threads)
    if left_right and not confidence:
        raise AnyNetError("--left-right belongs to --confidence")
    perturbations = perturbed.chosen(perturb or [])
    if perturbations and splits:
        raise AnyNetError("--perturb excludes --splits")
    if confidence and (model or method or splits or perturb):
        raise AnyNetError("--confidence excludes --model, --method, --perturb and --splits")
    if method and not (weights or model) and (input_scale, device, precision) != (None, "cpu", "float32"):
        raise AnyNetError("--input-scale, --device and --precision belong to networks: --weights or --model")
    if model and precision != "float32":
        raise AnyNetError("--precision belongs to --weights, not to --model")
    named = [(spec, open_dataset(spec)) for spec in data]
    for spec, samples in named:
        if not len(samples):
            raise AnyNetError(f"data set {spec!r}: expected at least one sample, got none")
    prepare, origin = _preparation(cameras, named[0][1], input_scale)
    regions = [choice.value for choice in region or [Region.all]]
    if out is not None:
        make_folder(out)  # before the work, not after it
    if confidence:
        predictors = {
            name: Predictor(name, device=device, precision=precision, threads=threads, input_scale=input_scale)
            for name in weights or ["default"]
        }
        _confidence(predictors, named, regions, left_right, prepare, origin, out)
        return
    methods: list[tuple[str, Method]] = []
    for name in weights or ([] if method or model else ["default"]):
        opened = open_method(name, device=device, precision=precision, threads=threads, input_scale=input_scale)
        methods.append((name, opened))
    for name in model or []:
        random = random_baseline(name, input_scale)
        methods.append((f"{name}, random weights", BaselinePredictor(random, device=device, threads=threads).stages))
    for choice in method or []:
        methods.append((f"OpenCV {choice.value.upper()}", {"bm": opencv.bm, "sgbm": opencv.sgbm}[choice.value]))
    if splits and (len(methods) != len(data) or len(regions) > 1):
        raise AnyNetError(
            "--splits: expected one region, and as many weights as data; "
            f"got {len(regions)}, {len(methods)}, {len(data)}"
        )
    if splits and len(set(zip((name for name, _ in methods), data, strict=True))) < len(data):
        raise AnyNetError("--splits: expected splits that differ, got the same weights on the same data twice")
    if splits:
        runs_on = zip(methods, (samples[0] for _, samples in named), strict=True)
        counts = [sum(1 for _ in run(first.left, first.right)) for (_, run), first in runs_on]
        if len(set(counts)) > 1:
            raise AnyNetError(f"--splits: expected methods of as many stages, got {', '.join(map(str, counts))}")
    # What takes turns, and on what data.
    rounds = (
        [(dict([m]), d) for m, d in zip(methods, named, strict=True)] if splits else [(dict(methods), d) for d in named]
    )
    figures = []
    if out is not None and not perturbations:
        figures = [out / f"{n}.png" for n in range(sum(len(runs) for runs, _ in rounds))]
        read = [vars(f).values() for _, samples in named if isinstance(samples, PairFiles) for f in samples.files]
        inputs = file_ids(path for paths in read for path in paths if isinstance(path, Path))
        check_not_inputs(figures, inputs)
    progress = Console(stderr=True)
    if perturbations:
        tables: dict[str, report.Results] = {perturbed.CLEAN: {}, **{name: {} for name in perturbations}}
        try:
            for (spec, samples), (kind, table) in product(named, tables.items()):
                clean = kind == perturbed.CLEAN
                changed = samples if clean else perturbed.Perturbed(samples, kind)
                status = escape(f"{kind}: {', '.join(dict(methods))} on {spec}")
                with progress.status(status), warnings.catch_warnings():
                    if not clean:
                        warnings.simplefilter("ignore")  # what was done to the images is known
                    for (name, where), evaluation in compare(dict(methods), changed, regions, prepare=prepare).items():
                        table[name, spec, where] = evaluation
        finally:  # of what was measured before an error, too
            if tables[perturbed.CLEAN]:
                values = {kind: report.to_json(table) for kind, table in tables.items()}
                _tell_results(perturbed.markdown(tables) + origin, values, out, "results")
        return
    results: report.Results = {}
    try:
        for runs, (spec, samples) in rounds:
            with progress.status(escape(f"{', '.join(runs)} on {spec}")):
                for run in () if splits else runs.values():  # which ran when their stages were counted
                    for _ in run(samples[0].left, samples[0].right):
                        pass  # a first time, which pays for the memory
                for (name, where), evaluation in compare(runs, samples, regions, prepare=prepare).items():
                    results[name, spec, where] = evaluation
    finally:  # of what was measured before an error, too
        if results:
            text = (report.splits_markdown(list(results.values())) if splits else report.markdown(results)) + origin
            _tell_results(text, report.to_json(results), out, "results")
    if out is not None:
        following = iter(figures)
        for runs, (_, samples) in rounds:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # it was told
                pair = next(prepared(with_truth(samples), prepare))
            for run in runs.values():
                write_image(next(following), report.figure(pair.method(run), pair.sample))


def _tell_results(text: str, values: object, out: Path | None, name: str) -> None:
    """Prints a table; into the folder `out`, if there is one, it goes too, and its values as JSON.

    If one of them fails, the other is still done.
    """
    from anynet.io.files import write_atomically

    try:
        print(text, end="", flush=True)
    finally:
        if out is not None:
            write_atomically(out / f"{name}.md", text.encode())
            write_atomically(out / f"{name}.json", json_text(values, indent=2).encode())


def _preparation(cameras: CameraOptions, samples: Dataset, input_scale: float | None) -> tuple[PairPreparation, str]:
    """What is done to the pairs, and what is said of their calibration."""
    from anynet.data.files import PairFiles

    size, image = None, None
    if cameras.calib and len(samples):
        height, width = samples[0].left.shape[:2]
        size, image = (width, height), samples.files[0].left if isinstance(samples, PairFiles) else None
    calibration = cameras.read(image, size)
    origin = "" if calibration is None or not calibration.origin else f"\nCalibration: {calibration.origin}.\n"
    return cameras.preparation(calibration, input_scale), origin


def _confidence(
    predictors: dict[str, Predictor],
    named: list[tuple[str, Dataset]],
    regions: list[str],
    left_right: bool,
    prepare: PairPreparation,
    origin: str,
    out: Path | None,
) -> None:
    """Measures, and tells, how good the confidences are."""
    from anynet.evaluation.confidence import ConfidenceScores, evaluate_confidence, markdown, to_json

    results: dict[tuple[str, str, str], dict[int, ConfidenceScores]] = {}
    try:
        for (spec, samples), (name, predictor), region in product(named, predictors.items(), regions):
            scores = evaluate_confidence(predictor, samples, region, left_right=left_right, prepare=prepare)
            results[name, spec, region] = scores
    finally:  # of what was measured before an error, too
        if results:
            _tell_results(markdown(results) + origin, to_json(results), out, "confidence")
