"""What is unusual in a calibration, said before its depths are believed."""

from __future__ import annotations

import math

from anynet.camera.calibration import Calibration

_LONGEST, _SHORTEST = 2.0, 2e-3  # meters of baseline: beyond, some other unit is likelier
_WIDEST, _NARROWEST = 0.2, 20.0  # focal lengths in image widths: fields of view of 136 and 3 degrees
_OFF_CENTER = 0.3  # of the image, principal point from the center
MAX_DISPARITY = 192  # pixels that the networks search


def check_baseline(baseline: float, hint: str = "") -> list[str]:
    """One sentence if a baseline, meters, is hardly one; else none. `hint` says in its end what to do."""
    if baseline > _LONGEST:
        hint = hint or (
            "are the calibration's lengths in millimeters or centimeters? "
            "Say it with --calib-unit mm (or cm, m), of a data set with unit=mm"
        )
        return [f"a baseline of {baseline:g} m is long: {hint}"]
    if baseline < _SHORTEST:
        hint = hint or (
            "are the calibration's lengths in meters? Say it with --calib-unit m (or mm, cm), of a data set with unit=m"
        )
        return [f"a baseline of {baseline:g} m is short: {hint}"]
    return []


def reach_of(input_scale: float | None) -> float:
    """The largest disparity that the networks find, pixels, when they work on images resized by this factor."""
    return MAX_DISPARITY / min(1.0, input_scale or 1.0)  # enlarged images are searched farther


def check_calibration(
    calibration: Calibration, width: int, height: int, reach: float = MAX_DISPARITY, smallest: float = 0.0
) -> list[str]:
    """What is implausible about a calibration for images of this size.

    Args:
        calibration: of a rectified pair.
        width, height: of the images, pixels.
        reach: the largest disparity that the network finds, pixels, counted from `smallest` on.
        smallest: the smallest disparity that is looked for, pixels.

    Returns:
        One sentence per finding.
    """
    findings = []
    largest = smallest + reach
    focal = calibration.focal
    if not _WIDEST * width < focal < _NARROWEST * max(width, height):
        findings.append(f"a focal length of {focal:g} pixels is implausible for images {width} pixels wide")
    findings += check_principal_point(calibration.cx, calibration.cy, width, height)
    if calibration.doffs <= -largest:
        findings.append(
            f"doffs is {calibration.doffs:g}: only disparities above {-calibration.doffs:g} pixels have a depth, "
            f"and the network finds those up to {largest:g}; check the calibration, or use a smaller --input-scale"
        )
    if abs(calibration.doffs) > width / 2:
        findings.append(f"doffs is {calibration.doffs:g}, more than half the images' width of {width} pixels")
    ndisp = calibration.ndisp
    if ndisp is not None and largest < ndisp < 0.9 * width:  # ETH3D's files have the width there, which says nothing
        findings.append(
            f"the scene has disparities up to {ndisp} pixels (ndisp), and the network finds those up to {largest:g}: "
            f"use --input-scale {scale_for(ndisp - smallest)} or less"
        )
    return findings


def check_principal_point(cx: float | None, cy: float | None, width: int, height: int) -> list[str]:
    """One sentence for each coordinate, pixels, that is hardly one of an image of this size; None says nothing."""
    findings = []
    for name, side, value in (("cx", width, cx), ("cy", height, cy)):
        if value is None:
            continue
        if not 0 <= value <= side:
            findings.append(
                f"the principal point lies outside the image ({name} {value:g} of {side} pixels): "
                "is the calibration for images of another size?"
            )
        elif abs(value - side / 2) > _OFF_CENTER * side:
            findings.append(
                f"the principal point lies far from the image's center ({name} {value:g} of {side} pixels): "
                "is the calibration for images of another size?"
            )
    return findings


def scale_for(disparity: float) -> float:
    """The `input_scale`, two digits, at which the network finds disparities up to this one, pixels."""
    return max(0.07, math.floor(95 * MAX_DISPARITY / disparity) / 100)
