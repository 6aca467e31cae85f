"""`anynet demo`: all stages on one pair, with times, errors and pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from anynet.cli.calibration import UNKNOWN, CameraOptions, with_cameras
from anynet.cli.network import Device, InputScale, Precision, Threads, Weights
from anynet.cli.results import check_not_inputs, file_ids
from anynet.cli.told import tell_warnings, warnings_first
from anynet.errors import AnyNetError
from anynet.io.files import make_folder

if TYPE_CHECKING:
    from anynet import Estimate, Predictor
    from anynet.camera import Calibration, PairPreparation, PreparedPair
    from anynet.samples import StereoSample

_FILES = "stages.png", "cloud.ply", "rectified_left.png", "rectified_right.png"
_RUNS = 5  # after one to warm up; the table has their medians


@with_cameras
def demo(
    left: Annotated[
        Path | None, typer.Argument(metavar="LEFT", help="Left image of a pair of your own.", show_default=False)
    ] = None,
    right: Annotated[Path | None, typer.Argument(metavar="RIGHT", help="Right image.", show_default=False)] = None,
    truth: Annotated[
        Path | None, typer.Option(help="Its true disparity: KITTI PNG, PFM, NPY or NPZ.", show_default=False)
    ] = None,
    truth_scale: Annotated[
        float | None, typer.Option(help="Levels per pixel of disparity in a PNG.", show_default="KITTI's 256")
    ] = None,
    cameras: CameraOptions = UNKNOWN,
    save_rectified: Annotated[bool, typer.Option("--save-rectified", help="Write the rectified images too.")] = False,
    rendered: Annotated[bool, typer.Option("--rendered", help="Use a rendered scene.")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="Which rendered scene.", show_default="0")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("anynet-demo"),
    weights: Weights = "default",
    input_scale: InputScale = None,
    device: Device = "cpu",
    precision: Precision = "float32",
    threads: Threads = None,
    view: Annotated[bool, typer.Option("--view", help="Then show the page of `anynet view` on the pair.")] = False,
) -> None:
    """Every stage on one pair: a table of times and errors, a picture of the stages, a point cloud.

    The pair is Middlebury's Motorcycle, which scikit-image carries, or a rendered one, or your own.
    """
    if (left is None) != (right is None):
        raise AnyNetError("expected two images or none")
    if rendered and left is not None:
        raise AnyNetError("--rendered and a pair of images exclude each other")
    if left is None and (truth or cameras.calibrated):
        raise AnyNetError("--truth and --calib belong to a pair of images")
    if truth is None and truth_scale is not None:
        raise AnyNetError("--truth-scale belongs to --truth")
    if not rendered and seed is not None:
        raise AnyNetError("--seed belongs to --rendered")

    inputs = file_ids(path for path in (left, right, truth) if path is not None)
    check_not_inputs((out / name for name in _FILES), inputs)
    with warnings_first():
        if left is not None and right is not None:
            sample = _own(left, right, truth, truth_scale)
            calibration = cameras.read(left, (sample.left.shape[1], sample.left.shape[0]))
        else:
            sample, calibration = _rendered(seed or 0) if rendered else _motorcycle()
        prepare = cameras.preparation(calibration, input_scale)
        pair = prepare(sample.left, sample.right)
    make_folder(out)

    from anynet import Predictor

    predictor = Predictor(weights, device=device, precision=precision, threads=threads, input_scale=input_scale)
    estimates, times = _run(predictor, prepare, sample)
    tell_warnings([*pair.warnings, *_truth_findings(sample, estimates[-1], truth)])
    _print_table(sample, estimates, times)
    for file in _write(out, pair, sample, estimates, times, save_rectified):
        print(file)
    if view:
        from anynet.cli.view import show
        from anynet.view import StillPair

        still = StillPair(sample.name, sample.left, sample.right)
        show(still, prepare, weights, input_scale, device, precision, threads, out)


def _motorcycle() -> tuple[StereoSample, Calibration]:
    """Middlebury 2014's Motorcycle at quarter size; the calibration is that of scikit-image's documentation."""
    from skimage.data import stereo_motorcycle

    from anynet.camera import Calibration
    from anynet.samples import StereoSample

    left, right, truth = stereo_motorcycle()  # type: ignore[no-untyped-call]
    sample = StereoSample(left, right, truth, valid=np.isfinite(truth), name="Motorcycle")
    return sample, Calibration(focal=994.978, baseline=0.193001, cx=311.193, cy=254.877, doffs=31.086)


def _rendered(seed: int) -> tuple[StereoSample, None]:
    from anynet.synthetic import render

    return render(seed), None


def _own(left: Path, right: Path, truth: Path | None, scale: float | None) -> StereoSample:
    from anynet.io import read_disparity, read_pair
    from anynet.samples import StereoSample

    images = read_pair(left, right)
    shape = images[0].shape[:2]
    disparity = np.full(shape, np.nan, np.float32) if truth is None else read_disparity(truth, scale)
    if disparity.shape != shape:
        raise AnyNetError(f"{truth}: expected a disparity map of {shape[1]} x {shape[0]}, got {disparity.shape[::-1]}")
    return StereoSample(*images, disparity, valid=np.isfinite(disparity), name=left.stem)


def _run(predictor: Predictor, prepare: PairPreparation, sample: StereoSample) -> tuple[list[Estimate], list[float]]:
    """The estimates, and each stage's time from the start in ms."""
    pair = prepare(sample.left, sample.right)
    fitting = pair.predictor(predictor)
    runs = [list(fitting.stages(pair.left, pair.right)) for _ in range(1 + _RUNS)][1:]
    times = np.median([[estimate.elapsed_ms for estimate in run] for run in runs], axis=0)
    return [replace(estimate, disparity=pair.known(estimate.disparity)) for estimate in runs[-1]], times.tolist()


def _truth_findings(sample: StereoSample, estimate: Estimate, truth: Path | None) -> list[str]:
    from anynet.evaluation.truth import check_truth

    return [f"{truth}: {finding}" for finding in check_truth(sample, estimate.disparity)]


def _print_table(sample: StereoSample, estimates: list[Estimate], times: list[float]) -> None:
    from anynet.evaluation.evaluate import fill_holes, region_mask
    from anynet.evaluation.metrics import scores

    height, width = sample.disparity.shape
    mask = region_mask(sample, "all")
    table = Table(title=f"{sample.name}, {width} x {height}")
    for column in ("stage", "ms", "EPE px", "bad-2 %", "D1 %")[: 5 if mask.any() else 2]:
        table.add_column(column, justify="right")
    for estimate, time in zip(estimates, times, strict=True):
        row = [str(estimate.stage), f"{time:.1f}"]
        if mask.any():
            score = scores(fill_holes(estimate.disparity), sample.disparity, mask)
            row += [f"{score.epe:.2f}", f"{score.bad2:.1f}", f"{score.d1:.1f}"]
        table.add_row(*row)
    Console().print(table)


def _write(
    out: Path,
    pair: PreparedPair,
    sample: StereoSample,
    estimates: list[Estimate],
    times: list[float],
    save_rectified: bool,
) -> list[Path]:
    """Writes the picture and, with a calibration, the point cloud; returns their names."""
    from anynet.io import write_image, write_ply
    from anynet.trust import within_reach
    from anynet.visualize import stages_image

    truth = np.where(sample.valid, sample.disparity, np.float32(np.nan)) if sample.valid.any() else None
    stages = [(f"stage {e.stage} ({t:.1f} ms)", e.disparity) for e, t in zip(estimates, times, strict=True)]
    picture, cloud, *rectified = (out / name for name in _FILES)
    files = [picture]
    write_image(picture, stages_image(pair.left, stages, truth))
    if pair.calibration is not None:
        files.append(cloud)
        depth = pair.calibration.depth(estimates[-1].disparity)
        near = within_reach(depth, pair.calibration, None)
        write_ply(cloud, pair.calibration.points(depth)[near], pair.left[near])
    if save_rectified:
        for path, image in zip(rectified, (pair.left, pair.right), strict=True):
            files.append(path)
            write_image(path, image)
    return files
