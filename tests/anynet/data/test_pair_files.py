"""Of anynet.data.files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from trees import tree

from anynet.data import open_dataset
from anynet.data.files import consistent
from anynet.errors import AnyNetError
from anynet.io import write_disparity


def test_truth_of_another_size_than_the_images(tmp_path: Path) -> None:
    tree(tmp_path, "left/a.png", "right/a.png")
    (tmp_path / "disparity").mkdir()
    write_disparity(tmp_path / "disparity/a.pfm", np.ones((5, 6), np.float32))
    with pytest.raises(AnyNetError, match=r"a.pfm: expected 20 x 12 pixels like the images, got \(6, 5\)"):
        open_dataset(f"folders:{tmp_path}")[0]


def test_consistent_is_what_the_right_view_says_too() -> None:
    disparity = np.full((2, 12), 3, np.float32)
    disparity[0, 7] = np.nan
    other = np.full_like(disparity, 3.5)
    other[1, 5] = 5
    expected = np.arange(12) >= np.full((2, 1), 3)
    expected[0, 7] = expected[1, 8] = False
    assert np.array_equal(consistent(disparity, other), expected)
    assert not consistent(disparity, other, tolerance=0.4).any()
