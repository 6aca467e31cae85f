"""`anynet demo`: all stages on one pair, with times, errors and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from anynet.errors import AnyNetError
from anynet.io.files import make_folder

if TYPE_CHECKING:
    from anynet import Estimate, Predictor
    from anynet.data import StereoSample
    from anynet.io import Calibration

_RUNS = 5  # after one to warm up; the table has their medians


def demo(
    left: Annotated[
        Path | None, typer.Argument(metavar="LEFT", help="Left image of a pair of your own.", show_default=False)
    ] = None,
    right: Annotated[Path | None, typer.Argument(metavar="RIGHT", help="Right image.", show_default=False)] = None,
    truth: Annotated[Path | None, typer.Option(help="Its true disparity: KITTI PNG, PFM, NPY or NPZ.")] = None,
    calib: Annotated[Path | None, typer.Option(help="Its calibration: KITTI, Middlebury or OpenCV.")] = None,
    rendered: Annotated[bool, typer.Option("--rendered", help="Use a rendered scene.")] = False,
    seed: Annotated[int, typer.Option(help="Which rendered scene.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("anynet-demo"),
    weights: Annotated[str, typer.Option(help="A packaged name, or a path.")] = "default",
    threads: Annotated[int | None, typer.Option(min=1, help="CPU threads.", show_default="torch's")] = None,
) -> None:
    """Every stage on one pair: a table of times and errors, a picture of the stages, a point cloud.

    The pair is Middlebury's Motorcycle, which scikit-image carries, or a rendered one, or your own.
    """
    if (left is None) != (right is None):
        raise AnyNetError("expected two images or none")
    if rendered and left is not None:
        raise AnyNetError("--rendered and a pair of images exclude each other")
    if left is None and (truth or calib):
        raise AnyNetError("--truth and --calib belong to a pair of images")

    from anynet import Predictor

    if left is not None and right is not None:
        sample, calibration = _own(left, right, truth, calib)
    else:
        sample, calibration = _rendered(seed) if rendered else _motorcycle()
    predictor = Predictor(weights=weights, threads=threads)
    estimates, times = _run(predictor, sample)
    _print_table(sample, estimates, times)
    for file in _write(out, sample, calibration, estimates, times):
        print(file)


def _motorcycle() -> tuple[StereoSample, Calibration]:
    """Middlebury 2014's Motorcycle at quarter size; the calibration is that of scikit-image's documentation."""
    from skimage.data import stereo_motorcycle

    from anynet.data import StereoSample
    from anynet.io import Calibration

    left, right, truth = stereo_motorcycle()  # type: ignore[no-untyped-call]
    sample = StereoSample(left, right, truth, valid=np.isfinite(truth), name="Motorcycle")
    return sample, Calibration(focal=994.978, baseline=0.193001, cx=311.193, cy=254.877, doffs=31.086)


def _rendered(seed: int) -> tuple[StereoSample, None]:
    from anynet.synthetic import render

    return render(seed), None


def _own(left: Path, right: Path, truth: Path | None, calib: Path | None) -> tuple[StereoSample, Calibration | None]:
    from anynet.data import StereoSample
    from anynet.io import read_calibration, read_disparity, read_pair

    images = read_pair(left, right)
    shape = images[0].shape[:2]
    disparity = np.full(shape, np.nan, np.float32) if truth is None else read_disparity(truth)
    if disparity.shape != shape:
        raise AnyNetError(f"{truth}: expected a disparity map of {shape[1]} x {shape[0]}, got {disparity.shape[::-1]}")
    sample = StereoSample(*images, disparity, valid=np.isfinite(disparity), name=left.stem)
    return sample, None if calib is None else read_calibration(calib)


def _run(predictor: Predictor, sample: StereoSample) -> tuple[list[Estimate], list[float]]:
    """The estimates, and each stage's time from the start in ms."""
    runs = [list(predictor.stages(sample.left, sample.right)) for _ in range(1 + _RUNS)][1:]
    times = np.median([[estimate.elapsed_ms for estimate in run] for run in runs], axis=0)
    return runs[-1], times.tolist()


def _print_table(sample: StereoSample, estimates: list[Estimate], times: list[float]) -> None:
    from anynet.evaluation.evaluate import region_mask
    from anynet.evaluation.metrics import scores

    height, width = sample.disparity.shape
    mask = region_mask(sample, "all")
    table = Table(title=f"{sample.name}, {width} x {height}")
    for column in ("stage", "ms", "EPE px", "bad-2 %", "D1 %")[: 5 if mask.any() else 2]:
        table.add_column(column, justify="right")
    for estimate, time in zip(estimates, times, strict=True):
        row = [str(estimate.stage), f"{time:.1f}"]
        if mask.any():
            score = scores(estimate.disparity, sample.disparity, mask)
            row += [f"{score.epe:.2f}", f"{score.bad2:.1f}", f"{score.d1:.1f}"]
        table.add_row(*row)
    Console().print(table)


def _write(
    out: Path, sample: StereoSample, calibration: Calibration | None, estimates: list[Estimate], times: list[float]
) -> list[Path]:
    """Writes the picture and, with a calibration, the point cloud; returns their names."""
    from anynet.io import write_image, write_ply
    from anynet.visualize import stages_image

    make_folder(out)
    truth = np.where(sample.valid, sample.disparity, np.float32(np.nan)) if sample.valid.any() else None
    stages = [(f"stage {e.stage} ({t:.1f} ms)", e.disparity) for e, t in zip(estimates, times, strict=True)]
    files = [out / "stages.png"]
    write_image(files[0], stages_image(sample.left, stages, truth))
    if calibration is not None:
        files.append(out / "cloud.ply")
        write_ply(files[1], calibration.points(calibration.depth(estimates[-1].disparity)), sample.left)
    return files
