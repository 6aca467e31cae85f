"""The options that describe the cameras, the same for every command that takes images."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from anynet.errors import AnyNetError

if TYPE_CHECKING:
    from anynet.camera import Calibration, StereoRig


class CameraPair(str, Enum):
    """KITTI's pairs of cameras."""

    gray = "gray"
    grey = "grey"
    color = "color"


Calib = Annotated[
    list[Path] | None,
    typer.Option(
        help="Calibration, of KITTI, Middlebury, OpenCV, ROS, Kalibr, ... (docs/calibration.md); repeatable, or a "
        "folder, where there are two files. One of raw cameras makes the images be rectified first.",
        show_default=False,
    ),
]
CalibUnit = Annotated[
    str | None,
    typer.Option(help="Unit of the calibration's lengths: m, cm, mm, in, ...", show_default="the format's, or meters"),
]
CalibPair = Annotated[
    CameraPair | None,
    typer.Option(help="Which of a KITTI file's cameras.", show_default="as the images' folder says, or color"),
]
Raw = Annotated[
    bool | None,
    typer.Option(
        "--raw/--rectified",
        help="The images are raw and to be rectified, or are rectified already.",
        show_default="as the calibration says",
    ),
]
Alpha = Annotated[
    float | None,
    typer.Option(
        min=0, max=1, help="Rectify to what both cameras see (0), to all (1), or between.", show_default="OpenCV's"
    ),
]
Focal = Annotated[
    float | None,
    typer.Option(
        help="Focal length, pixels. This and the next four give the calibration, or replace values of --calib.",
        show_default=False,
    ),
]
Baseline = Annotated[float | None, typer.Option(help="Distance between the cameras, meters.", show_default=False)]
Cx = Annotated[float | None, typer.Option(help="Principal point, pixels.", show_default="the center")]
Cy = Annotated[float | None, typer.Option(help="Principal point, pixels.", show_default="the center")]
Doffs = Annotated[float | None, typer.Option(help="cx of the right camera minus cx of the left.", show_default="0")]
MinDisparity = Annotated[
    int | None,
    typer.Option(
        help="Look for disparities from here on, such as -40 for toed-in cameras.",
        show_default="0, or below if matched corners and doffs say so",
    ),
]
Check = Annotated[
    bool, typer.Option("--check/--no-check", help="Warn if a pair looks unrectified, swapped or too near.")
]
FixRows = Annotated[
    bool, typer.Option("--fix-rows", help="Remove a small vertical shift and roll, found by matched corners.")
]


@dataclass(frozen=True)
class CameraOptions:
    """What the options say of the cameras."""

    files: tuple[Path, ...] = ()
    unit: str | None = None
    pair: CameraPair | None = None
    focal: float | None = None
    baseline: float | None = None
    cx: float | None = None
    cy: float | None = None
    doffs: float | None = None

    def read(self, image: Path | None = None, size: tuple[int, int] | None = None) -> Calibration | StereoRig | None:
        """The calibration, from files, from numbers, or from both; None if there is neither.

        Args:
            image: a left image, whose folder may tell which cameras it is from.
            size: width and height of the images.

        Raises:
            AnyNetError: if a file is not usable, or values are missing.
        """
        from anynet.camera import Calibration, read_calibration

        given = {name: getattr(self, name) for name in ("focal", "baseline", "cx", "cy", "doffs")}
        numbers = {name: value for name, value in given.items() if value is not None}
        if self.files:
            pair = None if self.pair is None else self.pair.value.replace("grey", "gray")
            return read_calibration(self.files, unit=self.unit, size=size, pair=pair, image=image, replace=numbers)
        if self.unit is not None or self.pair is not None:
            raise AnyNetError("--calib-unit and --calib-pair belong to --calib")
        if not numbers:
            return None
        missing = [f"--{name}" for name in ("focal", "baseline") if name not in numbers]
        if missing:
            raise AnyNetError(f"the calibration lacks {' and '.join(missing)}")
        return Calibration(**numbers, origin="options")
