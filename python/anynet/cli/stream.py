"""`anynet stream`: results as the frames come, from cameras, videos, folders and recordings."""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from anynet.cli.calibration import UNKNOWN, CameraOptions, with_cameras
from anynet.cli.network import BudgetMs, Device, InputScale, Precision, Stage, Threads, Weights
from anynet.cli.results import DepthFiles, DepthFormat, DisparityFile, Format, Writer, file_ids
from anynet.cli.sources import Rate, Reconnect, Size, Slop, Split, Topic, Topics, open_source
from anynet.cli.stopping import stopping
from anynet.cli.told import tell, tell_warnings
from anynet.cli.trust import Confidence, DropOccluded, LeftRight, MaxDepth, MinConfidence
from anynet.cli.view import show
from anynet.errors import AnyNetError
from anynet.io.files import make_folder
from anynet.json_text import json_text
from anynet.trust import Trust

if TYPE_CHECKING:
    from anynet.streams import Result, Sink, Stream

_HEARD = 100  # warnings between two frames


class DepthEncoding(str, Enum):
    """Of recorded depth images (REP 118)."""

    meters = "32FC1"
    millimeters = "16UC1"


@with_cameras
def stream(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="Camera (index, /dev/videoN, rtsp://...), video, folder or quoted pattern of images; or a ROS bag or "
            "MCAP file. Of the left images, or of both (--split, recordings).",
        ),
    ],
    right: Annotated[
        str | None, typer.Argument(metavar="[RIGHT]", help="The right camera, video, folder or pattern.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for files of every frame, as `predict` writes.")] = None,
    record: Annotated[
        list[Path] | None,
        typer.Option(help="Record ROS messages: FILE.mcap, FILE.bag (ROS 1), or FOLDER (ROS 2 bag); repeatable."),
    ] = None,
    video: Annotated[Path | None, typer.Option(help="Video of images and disparities in colors, FILE.mp4.")] = None,
    split: Split = False,
    rate: Rate = None,
    size: Size = None,
    topics: Topics = None,
    topic: Topic = None,
    slop: Slop = None,
    every_frame: Annotated[
        bool, typer.Option("--every-frame", help="Drop nothing: a recording waits for its results.")
    ] = False,
    frames: Annotated[int | None, typer.Option(min=1, help="Stop after so many results.")] = None,
    reconnect: Reconnect = None,
    weights: Weights = "default",
    input_scale: InputScale = None,
    budget_ms: BudgetMs = None,
    stage: Stage = None,
    format: DisparityFile = None,
    depth_format: DepthFiles = None,
    depth_encoding: Annotated[
        DepthEncoding | None,
        typer.Option(help="Recorded depth: float meters, or 16-bit millimeters.", show_default="32FC1"),
    ] = None,
    cameras: CameraOptions = UNKNOWN,
    max_depth: MaxDepth = None,
    confidence: Confidence = False,
    left_right: LeftRight = False,
    min_confidence: MinConfidence = 0.0,
    drop_occluded: DropOccluded = False,
    view: Annotated[
        bool, typer.Option("--view", help="Show the page of `anynet view` instead; its button saves into --out.")
    ] = False,
    device: Device = "cpu",
    precision: Precision = "float32",
    threads: Threads = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object per frame and line, and a last one with a summary.")
    ] = False,
) -> None:
    """Disparity, depth and clouds from a stream: the newest frame wins, nothing queues.

    While a frame is computed, newer ones replace each other; a frame that has its first estimate makes way for a newer
    one. Ctrl-C or SIGTERM ends the stream and completes what is written.
    """
    if view:
        computed = (record, video, frames, budget_ms, stage, every_frame, confidence, left_right, min_confidence,
                    drop_occluded, as_json, format, depth_format, depth_encoding, max_depth)  # fmt: skip
        if any(option not in (None, False, 0.0, []) for option in computed):
            raise AnyNetError(
                "--view excludes --record, --video, --frames, --budget-ms, --stage, --every-frame, --json, "
                "--max-depth, the formats of files and the options of confidence: the page has its own"
            )
    for name, option, owner, used in (
        ("--format", format, "--out", out),
        ("--depth-format", depth_format, "--out", out),
        ("--depth-encoding", depth_encoding, "--record", record),
        ("--max-depth", max_depth, "--out and --record", out or record),
    ):
        if option not in (None, []) and not used:
            raise AnyNetError(f"{name} belongs to {owner}")
    written = [os.path.abspath(path) for path in (*(record or ()), *([video] if video else ()))]
    if len(set(written)) < len(written):
        raise AnyNetError(f"--record and --video: expected files that differ, got {', '.join(written)}")
    trust = Trust(min_confidence, drop_occluded)

    from anynet.streams import Recorder, Stream, Video

    with (
        open_source(
            source, right, split=split, rate=rate, size=size, topics=topics, topic=topic, slop=slop, reconnect=reconnect
        ) as opened,
        _completed() as sinks,
    ):
        prepare, told = cameras.for_source(source, opened, input_scale)
        if view:
            show(
                opened, prepare, weights, input_scale, device, precision, threads, out or Path("anynet-view"),
                rate=rate, watch=cameras.check,
            )  # fmt: skip
            return

        from anynet import Predictor  # takes seconds, so after the cheap checks

        predictor = Predictor(weights, device=device, precision=precision, threads=threads, input_scale=input_scale)
        if stage is not None and stage > predictor.config.stages:
            raise AnyNetError(f"expected --stage from 1 to {predictor.config.stages}, got {stage}")
        running = Stream(
            opened, predictor, prepare=prepare, budget_ms=budget_ms, stage=stage, rate=rate, every_frame=every_frame,
            watch=cameras.check, confidence=confidence or left_right, left_right=left_right, trust=trust,
        )  # fmt: skip
        writer = None
        if out is not None:
            make_folder(out)
            formats = format or Format.png, tuple(depth_format or [DepthFormat.tiff])
            writer = Writer(out, *formats, max_depth, file_ids(opened.files))
        for path in record or ():
            sinks.append(Recorder(path, (depth_encoding or DepthEncoding.meters).value, max_depth))
        if video is not None:
            sinks.append(Video(video, opened.rate or 30))
        try:
            _run(running, writer, sinks, told, frames, as_json)
        finally:
            summary = running.statistics.summary()
            print(json_text({"summary": summary}) if as_json else _sentence(summary), flush=True)


def _run(
    running: Stream, writer: Writer | None, sinks: list[Sink], told: list[str], frames: int | None, as_json: bool
) -> None:
    with stopping(running.stop), _heard_warnings() as heard:
        for count, result in enumerate(running.results(), start=1):
            report = _process(result, writer, sinks)
            first = told if count == 1 else ()
            report["warnings"] = list(
                dict.fromkeys([*first, *result.warnings, *(heard.popleft() for _ in range(len(heard)))])
            )
            tell_warnings([warning for warning in report["warnings"] if warning not in told], report["name"])
            print(json_text(report) if as_json else _line(report), flush=True)
            if count == frames:
                running.stop()
        tell_warnings(dict.fromkeys(heard))  # of what came after the last result


def _process(result: Result, writer: Writer | None, sinks: list[Sink]) -> dict[str, Any]:
    """Writes everything for one frame; returns what `--json` prints."""
    from anynet.visualize import limits_of

    pair, estimate = result.pair, result.estimate
    files: dict[str, str] = {}
    if writer is not None:
        results = writer.of(result.frame.name)
        results.write_disparity("", estimate.disparity, limits_of(estimate.disparity))
        results.write_trust(estimate)
        if pair.calibration is not None:
            results.write_depth(estimate.disparity, pair.calibration, pair.left)
        results.tell_older()
        files = results.files
    for sink in sinks:
        sink.write(result)
    return {
        "name": result.frame.name,
        "stamp": result.frame.stamp / 1e9,
        "width": pair.left.shape[1],
        "height": pair.left.shape[0],
        "stage": estimate.stage,
        "elapsed_ms": [round(estimate.elapsed_ms, 3)],
        "calibration": None if pair.calibration is None else pair.calibration.values(),
        "files": files,
    }


@contextmanager
def _completed() -> Iterator[list[Sink]]:
    """A list of sinks that are closed at the end. Each loss is told: the last one is raised."""
    sinks: list[Sink] = []
    failure: BaseException | None = None
    try:
        yield sinks
    except BaseException as error:
        failure = error
    for sink in sinks:
        try:
            sink.close()
        except BaseException as error:  # the other sinks are closed all the same
            if isinstance(failure, AnyNetError):
                tell(str(failure))
            elif failure is not None and isinstance(error, AnyNetError):  # an interruption, which goes on
                tell(str(error))
                continue
            failure = error
    if failure is not None:
        raise failure


@contextmanager
def _heard_warnings() -> Iterator[deque[str]]:
    """Within, what `warnings.warn` tells on any thread; `collected_warnings` is for one thread alone."""
    heard: deque[str] = deque(maxlen=_HEARD)

    def hear(message: Warning | str, *_: Any, **__: Any) -> None:
        heard.append(str(message))

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = hear
        yield heard


def _line(report: dict[str, Any]) -> str:
    return (
        f"{report['name']}: {report['width']} x {report['height']}, stage {report['stage']} after "
        f"{report['elapsed_ms'][0]:.1f} ms"
    )


def _sentence(summary: dict[str, Any]) -> str:
    counts = f"{summary['frames']} frames, {summary['dropped']} dropped"
    if not summary["frames"]:
        return counts
    latency = summary["latency_ms"]
    return (
        f"{counts}, {summary['fps']:.1f} per second, results after {latency['p50']:.1f} ms (median), "
        f"{latency['p95']:.1f} ms (95 %), {latency['max']:.1f} ms (all)"
    )
