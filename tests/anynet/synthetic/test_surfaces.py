"""Surfaces lie where geometry says, in both views."""

from __future__ import annotations

import numpy as np
import pytest

from anynet.synthetic.geometry import Camera, Vector
from anynet.synthetic.materials import Material
from anynet.synthetic.surfaces import Fragment, Patch, Quadric, Relief, Surface

CAMERA = Camera(192, 128, 200.0, 96.0, 64.0)
MATERIAL = Material("noise", 0)


def cast(surface: Surface, view: int = 0) -> Fragment:
    window = CAMERA.window(surface.hull, view)
    assert window is not None
    fragment = surface.cast(CAMERA, view, window)
    assert fragment is not None
    assert fragment.disparity.shape == fragment.coverage.shape == window.size[::-1]
    return fragment


def flat(kind: type[Patch] = Patch, **options: float) -> Patch:
    """Three baselines wide and two high, ten away, its left side nearer."""
    origin, across, down = np.array([-1.0, -1.0, 8.0]), np.array([3.0, 0, 4.0]), np.array([0, 2.0, 0])
    return kind(origin, across, down, MATERIAL, **options)  # type: ignore[arg-type]


def depths_along_rays(fragment: Fragment, view: int) -> Vector:
    """Points [N, 3] of the opaque pixels."""
    x, y = np.broadcast_arrays(*fragment.window.grid)
    opaque = fragment.coverage == 255
    rays = np.stack([x - CAMERA.cx, y - CAMERA.cy, np.full_like(x, CAMERA.focal)], -1)
    points: Vector = rays[opaque] / fragment.disparity[opaque][:, None] + [view, 0, 0]
    return points


@pytest.mark.parametrize("view", [0, 1])
def test_a_patch_is_a_plane(view: int) -> None:
    patch = flat()
    points = depths_along_rays(cast(patch, view), view)
    assert len(points) > 500
    normal = np.cross(patch.across, patch.down)
    np.testing.assert_allclose((points - patch.origin) @ normal / np.linalg.norm(normal), 0, atol=1e-4)


@pytest.mark.parametrize("view", [0, 1])
def test_a_sphere_is_a_sphere(view: int) -> None:
    sphere = Quadric(np.array([0.5, 0, 10.0]), np.eye(3) / 1.5, MATERIAL)
    points = depths_along_rays(cast(sphere, view), view)
    assert len(points) > 500
    np.testing.assert_allclose(np.linalg.norm(points - sphere.center, axis=1), 1.5, atol=1e-2)
    assert (points[:, 2] < 10).all()  # the near side


def test_a_relief_swells_about_its_patch_alike_in_both_views() -> None:
    plane, relief = cast(flat()), cast(flat(Relief, strength=0.1))
    inside = relief.coverage == 255
    y, x = np.nonzero(inside)
    offset = np.subtract(relief.window[:2], plane.window[:2])
    there = plane.disparity[np.clip(y + offset[1], 0, plane.disparity.shape[0] - 1),
                            np.clip(x + offset[0], 0, plane.disparity.shape[1] - 1)]  # fmt: skip
    ratio = relief.disparity[inside] / there
    assert 0.02 < ratio.std() < 0.1
    other = cast(flat(Relief, strength=0.1), 1)
    column = np.rint(x + relief.window.left - relief.disparity[inside] - other.window.left).astype(int)
    row = y + relief.window.top - other.window.top
    seen = (column >= 0) & (column < other.disparity.shape[1])
    assert seen.mean() > 0.9
    difference = np.abs(other.disparity[row[seen], column[seen]] - relief.disparity[inside][seen])
    assert np.median(difference) < 0.2


def test_paint_is_asked_for_by_window() -> None:
    for surface in (flat(), flat(Relief, strength=0.1), Quadric(np.array([0.5, 0, 10.0]), np.eye(3) / 1.5, MATERIAL)):
        fragment = cast(surface)
        colors = fragment.paint(fragment.window)
        assert colors.shape == (*fragment.disparity.shape, 3)
        assert colors[fragment.coverage == 255].std() > 1


def test_what_cannot_be_seen() -> None:
    edge_on = Patch(np.array([0, 0, 5.0]), np.array([0, 0, 2.0]), np.array([0, 1.0, 0]), MATERIAL)
    window = CAMERA.window(edge_on.hull, 0)
    assert window is not None
    assert edge_on.cast(CAMERA, 0, window) is None
    around = Quadric(np.array([0, 0, 1.0]), np.eye(3) / 5, MATERIAL)
    assert CAMERA.window(around.hull, 0) is None
