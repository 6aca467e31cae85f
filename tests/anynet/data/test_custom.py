from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from trees import SIZE, check, tree

from anynet.data import open_dataset
from anynet.errors import AnyNetError


def test_own_folders_and_table(tmp_path: Path) -> None:
    tree(tmp_path, "left/a.png", "right/a.png", "disparity/a.pfm", "left/b.png")
    check(open_dataset(f"folders:{tmp_path}"), ["a"])
    (tmp_path / "calib.txt").write_text("cam0=[100 0 10; 0 100 6; 0 0 1]\nbaseline=120\ndoffs=1\nwidth=20\nheight=12\n")
    np.save(tmp_path / "depth.npy", np.full(SIZE, 3, np.float32))
    listing = tmp_path / "pairs.csv"
    listing.write_text(
        "left,right,disparity,depth,calibration\n"
        "left/a.png,right/a.png,disparity/a.pfm,,\n"
        "left/a.png,right/a.png,,depth.npy,calib.txt\n"
        "left/a.png,right/a.png,,,\n"
    )
    measured, computed, unknown = open_dataset(f"csv:{listing}")
    assert np.allclose(measured.disparity, 3)
    assert np.allclose(computed.disparity, 100 * 0.12 / 3 - 1)
    assert not unknown.valid.any()
    assert np.isnan(unknown.disparity).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("left,disparity\n", "expected columns among left, right"),
        ("left,right,color\n", "expected columns among left, right"),
        (
            "left,right,depth\na.png,b.png,c.npy\n",
            r"pairs.csv:2: expected left, right, and disparity or depth \+ calibration",
        ),
    ],
)
def test_wrong_tables(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "pairs.csv").write_text(text)
    with pytest.raises(AnyNetError, match=message):
        open_dataset(f"csv:{tmp_path / 'pairs.csv'}")
