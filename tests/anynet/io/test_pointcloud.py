from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData

from anynet.errors import AnyNetError
from anynet.io import write_ply


def test_points_and_colors_without_unknown(tmp_path: Path) -> None:
    points = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    points[0, 1, 2] = np.nan
    colors = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    write_ply(tmp_path / "cloud.ply", points, colors)
    ply = PlyData.read(tmp_path / "cloud.ply")
    assert not ply.text
    assert ply.byte_order == "<"
    vertices = ply["vertex"].data
    assert vertices.dtype.names == ("x", "y", "z", "red", "green", "blue")
    kept = [0, 2, 3, 4, 5]
    np.testing.assert_array_equal(np.stack([vertices[n] for n in "xyz"], 1), points.reshape(-1, 3)[kept])
    np.testing.assert_array_equal(
        np.stack([vertices[n] for n in ("red", "green", "blue")], 1), colors.reshape(-1, 3)[kept]
    )


def test_a_cloud_may_be_empty(tmp_path: Path) -> None:
    write_ply(tmp_path / "cloud.ply", np.full((2, 2, 3), np.nan, np.float32), np.zeros((2, 2, 3), np.uint8))
    assert len(PlyData.read(tmp_path / "cloud.ply")["vertex"].data) == 0


def test_points_and_colors_that_do_not_fit(tmp_path: Path) -> None:
    points, colors = np.zeros((2, 3, 3), np.float32), np.zeros((2, 3, 3), np.uint8)
    for one, other in (
        (points, colors[:1]),
        (points, colors[..., 0]),
        (points[..., :2], colors[..., :2]),
        (points, points),
    ):
        with pytest.raises(AnyNetError, match=r"cloud.ply: expected points \[..., 3\] and their colors as uint8"):
            write_ply(tmp_path / "cloud.ply", one, other)
    assert not list(tmp_path.iterdir())
