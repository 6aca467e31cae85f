"""The options that describe the cameras, the same for every command that takes images."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from anynet.cli.told import tell_warnings, warnings_first
from anynet.errors import AnyNetError

if TYPE_CHECKING:
    from anynet.camera import Calibration, PairPreparation, StereoRig
    from anynet.streams import Source


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
    """What the options say of the cameras; its fields are the options (`with_cameras`)."""

    calib: Calib = None
    calib_unit: CalibUnit = None
    calib_pair: CalibPair = None
    focal: Focal = None
    baseline: Baseline = None
    cx: Cx = None
    cy: Cy = None
    doffs: Doffs = None
    raw: Raw = None
    alpha: Alpha = None
    fix_rows: FixRows = False
    min_disparity: MinDisparity = None
    check: Check = True

    @property
    def calibrated(self) -> bool:
        """Whether they say anything of a calibration."""
        return bool(self.calib or self._numbers or self.calib_unit is not None or self.calib_pair is not None)

    @property
    def _numbers(self) -> dict[str, Any]:
        given = {name: getattr(self, name) for name in ("focal", "baseline", "cx", "cy", "doffs")}
        return {name: value for name, value in given.items() if value is not None}

    def read(self, image: Path | None = None, size: tuple[int, int] | None = None) -> Calibration | StereoRig | None:
        """The calibration, from files, from numbers, or from both; None if there is neither.

        Args:
            image: a left image, whose folder may tell which cameras it is from.
            size: width and height of the images.

        Raises:
            AnyNetError: if a file is not usable, or values are missing.
        """
        numbers = self._numbers
        if self.calib:
            from anynet.camera import read_calibration

            pair = None if self.calib_pair is None else self.calib_pair.value.replace("grey", "gray")
            cameras = read_calibration(
                self.calib, unit=self.calib_unit, size=size, pair=pair, image=image, replace=numbers
            )
            of_rectified = [f"--{name}" for name in numbers if name != "baseline"]
            if self.raw and of_rectified:
                raise AnyNetError(f"--raw: {', '.join(of_rectified)} cannot replace values of rectified images")
            return cameras
        if self.calib_unit is not None or self.calib_pair is not None:
            raise AnyNetError("--calib-unit and --calib-pair belong to --calib")
        if not numbers:
            return None
        missing = [f"--{name}" for name in ("focal", "baseline") if name not in numbers]
        if missing:
            raise AnyNetError(f"the calibration lacks {' and '.join(missing)}")
        from anynet.camera import Calibration
        from anynet.camera.plausibility import check_baseline

        calibration = Calibration(**numbers, origin="options")
        for warning in check_baseline(calibration.baseline, "--baseline is in meters"):
            warnings.warn(warning, stacklevel=2)
        return calibration

    def for_source(self, named: str, source: Source, input_scale: float | None) -> tuple[PairPreparation, list[str]]:
        """What is done to every pair of a source of frames, of that name; and what was warned of, which is told.

        Its own calibration counts if the options give none.
        """
        tell_warnings(source.warnings)
        with warnings_first() as told:
            cameras = self.read(Path(named), source.size if self.calib else None) or source.calibration
            return self.preparation(cameras, input_scale), told

    def preparation(self, cameras: Calibration | StereoRig | None, input_scale: float | None) -> PairPreparation:
        """What is done to every pair of these cameras."""
        from anynet.camera import PairPreparation
        from anynet.camera.plausibility import reach_of

        return PairPreparation(
            cameras, raw=self.raw, alpha=self.alpha, check=self.check, fix_rows=self.fix_rows,
            min_disparity=self.min_disparity, reach=reach_of(input_scale),
        )  # fmt: skip


UNKNOWN = CameraOptions()


def with_cameras(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of `CameraOptions` in place of its parameter `cameras`."""
    options = fields(CameraOptions)
    types = get_type_hints(CameraOptions, include_extras=True)
    own = get_type_hints(command, include_extras=True)
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name == "cameras":
            parameters += [
                inspect.Parameter(o.name, parameter.kind, default=o.default, annotation=types[o.name]) for o in options
            ]
        else:
            parameters.append(parameter.replace(annotation=own[parameter.name]))

    @wraps(command)
    def expanded(**given: Any) -> None:
        cameras = CameraOptions(**{option.name: given.pop(option.name) for option in options})
        command(**given, cameras=cameras)

    expanded.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return expanded
