"""What the tests of the loaders share: tiny trees of files in a data set's layout, and the real pairs' place."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from anynet.data import Dataset, StereoSample
from anynet.io import write_disparity

SHARED = Path(__file__).resolve().parents[4] / "shared" / "data"
SIZE = (12, 20)


def mismatch(sample: StereoSample, offset: int) -> float:
    """Mean difference of left pixels and the right ones `offset` away from where the truth says they are."""
    left, right = (cv2.GaussianBlur(image, (0, 0), 1).astype(np.float32) for image in (sample.left, sample.right))
    y, x = np.nonzero(sample.valid if sample.noc is None else sample.noc)
    match = np.rint(x - sample.disparity[y, x]).astype(int) + offset
    inside = (match >= 0) & (match < left.shape[1])
    return float(np.abs(left[y, x] - right[y, np.clip(match, 0, left.shape[1] - 1)])[inside].mean())


def tree(root: Path, *entries: str) -> None:
    """Files with these paths: gray images of level 90, disparities of 3 pixels (PNG: 16 bits, 8 if named 8:PATH)."""
    for entry in entries:
        path = root / entry.removeprefix("8:")
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".pfm":
            write_disparity(path, np.full(SIZE, 3, np.float32))
        elif entry.startswith("8:"):
            cv2.imwrite(str(path), np.full(SIZE, 24, np.uint8))
        elif "disp" in entry:
            write_disparity(path, np.full(SIZE, 3, np.float32))
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), np.full((*SIZE, 3), 90, np.uint8))


def check(dataset: Dataset, names: list[str], disparity: float = 3) -> None:
    assert [s.name for s in dataset] == names
    for sample in dataset:
        assert sample.left.shape == (*SIZE, 3)
        assert np.allclose(sample.disparity, disparity)
        assert sample.valid.all()
