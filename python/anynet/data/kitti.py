"""KITTI 2012 and 2015 stereo (https://www.cvlibs.net/datasets/kitti): whole or partial training sets.

Left is camera 2 (2015: image_2) or 0 (2012: colored_0, or the gray image_0). Truth is that of frame *_10, `occ` (all
known pixels) or `noc` (those that the right camera sees too).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from anynet.data.files import Files, PairFiles, files_in, folder, names_in, nothing
from anynet.errors import AnyNetError
from anynet.names import listed


def kitti2015(root: str | Path, truth: str = "noc", split: str | None = None, without: str | None = None) -> PairFiles:
    """The samples of root/training that have both images and the chosen truth.

    Args:
        truth: "occ" or "noc". With "occ", `noc` of a sample comes from disp_noc_0 where that is present.
        split: a file with the names to take, one a line (000004_10.png, or 000004_10, or 000004), in that order.
        without: a file with names to leave out.
    """
    return _kitti("kitti2015", root, truth, split, without, [("image_2", "image_3")], "_0")


def kitti2012(root: str | Path, truth: str = "noc", split: str | None = None, without: str | None = None) -> PairFiles:
    """As `kitti2015`; color images where they are present, else gray ones."""
    return _kitti("kitti2012", root, truth, split, without, [("colored_0", "colored_1"), ("image_0", "image_1")], "")


def _kitti(
    name: str,
    root: str | Path,
    truth: str,
    split: str | None,
    without: str | None,
    cameras: Sequence[tuple[str, str]],
    suffix: str,
) -> PairFiles:
    if truth not in ("occ", "noc"):
        raise AnyNetError(f'{name}: expected truth "occ" or "noc", got {truth!r}')
    wanted = f"training/{cameras[0][0]}, {cameras[0][1]} and disp_{truth}{suffix} with files NNNNNN_10.png"
    path = folder(root, wanted)
    training = path / "training"
    files = {}
    for left, right in cameras:
        for image in files_in(training / left, "*_10.png"):
            disparity = training / f"disp_{truth}{suffix}" / image.name
            if image.stem in files or not disparity.exists() or not (training / right / image.name).exists():
                continue
            noc, objects = training / f"disp_noc{suffix}" / image.name, training / "obj_map" / image.name
            files[image.stem] = Files(
                name=image.stem,
                left=image,
                right=training / right / image.name,
                disparity=disparity,
                noc=noc if noc.exists() else None,
                foreground=objects if objects.exists() else None,
            )
    if not files:
        raise nothing(training if training.is_dir() else path, wanted)

    def named(file: str) -> list[str]:
        stems = [_stem(name) for name in names_in(file, path)]
        if missing := [stem for stem in stems if stem not in files]:
            raise AnyNetError(f"{root}: {file} names {listed(missing, 1)}, not there with {wanted}")
        return stems

    chosen = sorted(files) if split is None else named(split)
    excluded = [] if without is None else named(without)
    return PairFiles(name, [files[n] for n in chosen if n not in excluded])


def _stem(line: str) -> str:
    stem = Path(line).stem
    return stem if stem.endswith("_10") else f"{stem}_10"
