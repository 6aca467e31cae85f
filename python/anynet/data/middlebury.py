"""Middlebury stereo (https://vision.middlebury.edu/stereo/data) and ETH3D two-view (https://www.eth3d.net).

A root is a folder of scenes, or one scene. Where a set has a truth for the right view, `noc` is found by comparing.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from anynet.data.files import Files, PairFiles, first_existing, folder, nothing
from anynet.io.images import image_size


def _scenes(name: str, root: str | Path, wanted: str, scene: Callable[[Path], Files | None]) -> PairFiles:
    path = folder(root, wanted)
    places = [path, *sorted(p for p in path.iterdir() if p.is_dir() and p.name[0] != ".")]
    files = [found for found in map(scene, places) if found is not None]
    if not files:
        raise nothing(path, wanted)
    return PairFiles(name, files)


def _height(image: Path) -> int:
    return image_size(image)[1]


def middlebury2001(root: str | Path) -> PairFiles:
    """sawtooth, venus, bull, poster, barn1, barn2 (im2.ppm, im6.ppm, disp2.pgm / 8); map (im0, im1, disp0.pgm / 8)."""

    def scene(path: Path) -> Files | None:
        for left, right in ((2, 6), (0, 1)):
            image = first_existing(path / f"im{left}{suffix}" for suffix in (".ppm", ".pgm", ".png"))
            truth = first_existing(path / f"disp{left}{suffix}" for suffix in (".pgm", ".png"))
            if image is not None and truth is not None:
                other = first_existing([path / f"disp{right}{truth.suffix}"])
                second = path / f"im{right}{image.suffix}"
                return Files(name=path.name, left=image, right=second, disparity=truth, scale=8, other=other)
        return None

    return _scenes("middlebury2001", root, "scenes with im2.ppm, im6.ppm and disp2.pgm", scene)


def middlebury2003(root: str | Path) -> PairFiles:
    """teddy, cones: im2, im6, disp2.png / 4 at quarter size, / 2 at half size, / 1 at full size."""

    def scene(path: Path) -> Files | None:
        image, truth = first_existing([path / "im2.png", path / "im2.ppm"]), path / "disp2.png"
        if image is None or not truth.exists():
            return None
        second, other = path / f"im6{image.suffix}", path / "disp6.png"
        return Files(
            name=path.name, left=image, right=second, disparity=truth, scale=round(1500 / _height(image)),
            other=other if other.exists() else None,
        )  # fmt: skip

    return _scenes("middlebury2003", root, "scenes with im2.png, im6.png and disp2.png", scene)


def middlebury2006(root: str | Path) -> PairFiles:
    """Sets 2005 and 2006: view1 left, view5 right, disp1.png / 3 at third size, / 2 at half size, / 1 at full size."""

    def scene(path: Path) -> Files | None:
        image, second = path / "view1.png", path / "view5.png"
        truth, other = path / "disp1.png", path / "disp5.png"
        if not image.exists():  # folders with several lights and exposures; these are the usual ones
            image, second = (path / "Illum1" / "Exp1" / view.name for view in (image, second))
        if not (image.exists() and second.exists() and truth.exists()):
            return None
        return Files(
            name=path.name, left=image, right=second, disparity=truth, scale=round(1110 / _height(image)),
            other=other if other.exists() else None,
        )  # fmt: skip

    return _scenes("middlebury2006", root, "scenes with view1.png, view5.png and disp1.png", scene)


def _modern(path: Path) -> Files | None:
    """im0.png, im1.png, disp0GT.pfm or disp0.pfm, with mask0nocc.png or the right view's truth where present."""
    image, second = path / "im0.png", path / "im1.png"
    beside = path.parents[1] / "two_view_training_gt" / path.name if len(path.parents) > 1 else path
    truth = first_existing(place / file for place in (path, beside) for file in ("disp0GT.pfm", "disp0.pfm"))
    if truth is None or not image.exists():
        return None
    return Files(
        name=path.name,
        left=image,
        right=second,
        disparity=truth,
        noc=first_existing([truth.parent / "mask0nocc.png"]),
        other=first_existing([truth.with_name(truth.name.replace("disp0", "disp1"))]),
        calibration=first_existing([path / "calib.txt"]),
    )


def middlebury2014(root: str | Path) -> PairFiles:
    """Sets 2014 and 2021, and the benchmark's training set at any size."""
    return _scenes("middlebury2014", root, "scenes with im0.png, im1.png and disp0GT.pfm or disp0.pfm", _modern)


def eth3d(root: str | Path) -> PairFiles:
    """Two-view training set: two_view_training/SCENE, with truth beside it in two_view_training_gt or in the scene."""
    inner = Path(root) / "two_view_training"
    where = inner if os.path.isdir(inner) else root
    return _scenes("eth3d", where, "scenes with im0.png, im1.png and disp0GT.pfm or disp0.pfm", _modern)
