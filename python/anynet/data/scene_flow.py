"""Scene Flow (https://lmb.informatik.uni-freiburg.de/resources/datasets): FlyingThings3D, Monkaa, Driving.

All three keep .../left/NNNN.png under frames_cleanpass or frames_finalpass, and NNNN.pfm at the same place under
disparity: whatever lies between (TRAIN/A/0000; a scene; focal length, direction and speed) is kept as the name.
"""

from __future__ import annotations

from pathlib import Path

from anynet.data.files import Files, PairFiles, files_in, first_existing, folder, nothing
from anynet.errors import AnyNetError


def scene_flow(root: str | Path, appearance: str = "clean", within: str = "") -> PairFiles:
    """All pairs of one of the sets, or of those in the sub-folders of `root`.

    Args:
        appearance: "clean" or "final", the pass.
        within: only pairs whose path begins so, e.g. "TRAIN", "TEST/A", "35mm_focallength/scene_forwards/slow".
    """
    if appearance not in ("clean", "final"):
        raise AnyNetError(f'scene flow: expected appearance "clean" or "final", got {appearance!r}')
    wanted = f"frames_{appearance}pass and disparity, holding .../left/NNNN.png and .pfm"
    path = folder(root, wanted)
    files = []
    for place in (path, *sorted(p for p in path.iterdir() if p.is_dir())):
        frames = first_existing(
            place / f"{prefix}_{appearance}pass" for prefix in ("frames", "RGB")
        )  # RGB: the sampler
        if frames is None:
            continue
        for left in files_in(frames, "**/left/*.png"):
            between = left.relative_to(frames).parent.parent
            truths = place / "disparity" / between
            truth = first_existing((truths / "left" / f"{left.stem}.pfm", truths / f"{left.stem}.pfm"))
            if truth is None or not between.as_posix().startswith(within):
                continue
            other = first_existing([truths / "right" / f"{left.stem}.pfm"])
            right = left.parents[1] / "right" / left.name
            files.append(
                Files(name=(between / left.stem).as_posix(), left=left, right=right, disparity=truth, other=other)
            )
    if not files:
        raise nothing(path, wanted + (f", within {within}" if within else ""))
    return PairFiles("scene_flow", files)
