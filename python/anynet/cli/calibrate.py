"""`anynet calibrate`: a rig's calibration from images of a board."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from anynet.cli.sources import Size, Slop, Topic, Topics, open_source
from anynet.cli.stopping import stopping
from anynet.cli.told import tell, tell_warnings
from anynet.errors import AnyNetError
from anynet.io.files import check_output
from anynet.json_text import json_text

if TYPE_CHECKING:
    from anynet.camera.boards import Image, View
    from anynet.camera.calibrate import BoardCalibration
    from anynet.streams import Frame, Source

_DICTIONARY, _VIEWS = "4X4_50", 40
_STEP = 10  # frames of a video from one look to the next
_MOVED = 0.04  # of the image's width that the board moves from one view of a video to another
_LINES = 20  # epipolar lines in the picture


class Model(str, Enum):
    """How the lenses bend."""

    pinhole = "pinhole"
    rational = "rational"
    fisheye = "fisheye"


def calibrate(
    left: Annotated[
        str,
        typer.Argument(
            metavar="LEFT",
            help="Images of the left camera: folder, pattern, video, camera, recording, as of `anynet stream`.",
        ),
    ],
    right: Annotated[
        str | None,
        typer.Argument(
            metavar="RIGHT", help="Those of the right one; none with --split and of recordings.", show_default=False
        ),
    ] = None,
    board: Annotated[
        str, typer.Option(help="Inner corners of the chessboard, or squares of the ChArUco board: COLUMNSxROWS.")
    ] = "9x6",
    square: Annotated[float, typer.Option(help="Side of a square, meters.")] = 0.025,
    charuco: Annotated[
        float, typer.Option(help="A ChArUco board with markers of this side, meters.", show_default="a chessboard")
    ] = 0.0,
    dictionary: Annotated[
        str | None,
        typer.Option(help="Dictionary of the markers, such as 4X4_50 or 5X5_1000.", show_default=_DICTIONARY),
    ] = None,
    model: Annotated[Model, typer.Option(help="Lenses: 5 coefficients, 8, or fisheye.")] = Model.pinhole,
    split: Annotated[
        bool, typer.Option("--split", help="Each image has both views side by side, the left one first.")
    ] = False,
    size: Size = None,
    topics: Topics = None,
    topic: Topic = None,
    slop: Slop = None,
    views: Annotated[
        int | None,
        typer.Option(min=5, max=500, help="Stop a video or camera after so many views.", show_default=str(_VIEWS)),
    ] = None,
    out: Annotated[Path, typer.Option(help="The calibration; the picture gets its name and _epipolar.png.")] = Path(
        "stereo.yaml"
    ),
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object, for machines.")] = False,
) -> None:
    """Calibrate two cameras with pictures of a board, for --calib.

    Hold the board near and far, tilted, and into every corner of both images: 20 views are good. Views that do not fit
    are left out. Of a camera, Ctrl-C ends the looking. Writes one YAML with the raw and the rectified cameras, and a
    rectified pair with epipolar lines.
    """
    from anynet.camera.boards import Board, find_view
    from anynet.camera.calibrate import calibrate as solve
    from anynet.camera.write import write_rig
    from anynet.io import write_image
    from anynet.streams import ImageFiles

    columns, _, rows = board.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal() and len(board) < 12):
        raise AnyNetError(f"expected --board COLUMNSxROWS such as 9x6, got {board}")
    if dictionary is not None and not charuco:
        raise AnyNetError("--dictionary belongs to --charuco")
    target = Board(int(columns), int(rows), square, charuco, dictionary or _DICTIONARY)

    check_output(out)
    picture = out.with_name(f"{out.stem}_epipolar.png")
    check_output(picture)
    source = open_source(left, right, split=split, size=size, topics=topics, topic=topic, slop=slop)
    tell_warnings(source.warnings)
    moving = not isinstance(source, ImageFiles)
    if views is not None and not moving:
        raise AnyNetError(f"--views belongs to videos, cameras and recordings, got images: {left}")
    found: list[View] = []
    left_out: list[tuple[str, str]] = []
    here: tuple[int, int] | None = None
    shown: tuple[Image, Image] | None = None
    # Ctrl-C: the user has shown enough.
    with source, stopping(source.close), Console(stderr=True).status("looking for the board") as status:
        for frame in _frames(source):
            now = frame.left.shape[1], frame.left.shape[0]
            if here is not None and now != here:
                raise AnyNetError(
                    f"{frame.name}: expected images of one size, {here[0]} x {here[1]}, got {now[0]} x {now[1]}"
                )
            here = now
            view = find_view(target, frame.name, frame.left, frame.right)
            if isinstance(view, str):
                if not moving:
                    left_out.append((frame.name, view))
            elif not moving or all(view.differs(other, _MOVED * now[0]) for other in found):
                found.append(view)
                shown = frame.left, frame.right
                status.update(f"{len(found)} views; looking for the board")
                if moving and len(found) == (views or _VIEWS):
                    break
    if here is None or shown is None:
        raise AnyNetError(f"no board of {board} ({'ChArUco' if charuco else 'chessboard'}) found in {left}")
    result = solve(found, here, model.value)
    left_out += result.left_out
    files: dict[str, str] = {}
    try:
        write_rig(
            out, result.rig,
            {"reprojection_error": result.reprojection, "vertical_error": result.vertical, "views": len(result.views)},
        )  # fmt: skip
        files["calibration"] = str(out)
        write_image(picture, _epipolar(*result.rectification(*shown)))
        files["epipolar"] = str(picture)
    finally:
        _print(result, left_out, files, as_json)  # also where the disk is full


def _frames(source: Source) -> Iterator[Frame]:
    """Every frame of images and live cameras, one in some of recordings."""
    from anynet.streams import ImageFiles

    step = 1 if source.live or isinstance(source, ImageFiles) else _STEP
    for number, frame in enumerate(source.frames()):
        if number % step == 0:
            yield frame


def _epipolar(left: Image, right: Image) -> Image:
    """The rectified images side by side: what lies on a line in one lies on it in the other."""
    import cv2
    import numpy as np

    picture = np.hstack([left, right])
    height, width = picture.shape[:2]
    for row in range(height // _LINES // 2, height, max(1, height // _LINES)):
        cv2.line(picture, (0, row), (width - 1, row), (0, 255, 0), 1)
    return picture


def _print(result: BoardCalibration, left_out: list[tuple[str, str]], files: dict[str, str], as_json: bool) -> None:
    for name, why in left_out:
        tell(f"{name}: left out: {why}")
    calibration = result.rectification.calibration
    if as_json:
        report = {
            "views": len(result.views), "left_out": dict(left_out), "reprojection_error": result.reprojection,
            "vertical_error": result.vertical, "vertical_error_largest": result.vertical_largest,
            "focal": [float(camera.matrix[0, 0]) for camera in (result.rig.left, result.rig.right)],
            "baseline": result.rig.baseline, "calibration": calibration.values(),
            "files": files,
        }  # fmt: skip
        print(json_text(report))
        return
    print(f"{len(result.views)} views used, {len(left_out)} left out")
    print(f"reprojection error {result.reprojection:.3f} pixels (root mean square)")
    print(f"vertical error after rectification {result.vertical:.3f} pixels, at most {result.vertical_largest:.3f}")
    print(f"focal length {calibration.focal:.2f} pixels, baseline {calibration.baseline:.5f} m (rectified)")
    for file in files.values():
        print(file)
