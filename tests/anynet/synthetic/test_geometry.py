from __future__ import annotations

import numpy as np

from anynet.synthetic.geometry import NEAREST, Camera, Window, rotation

CAMERA = Camera(192, 128, 200.0, 96.0, 64.0)


def test_rotations_are_proper_and_in_order() -> None:
    turn = rotation(0.3, -0.7, 1.1)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) > 0
    np.testing.assert_allclose(turn, rotation(0, 0, 1.1) @ rotation(0, -0.7) @ rotation(0.3), atol=1e-12)
    np.testing.assert_allclose(rotation(np.pi / 2) @ [0, 0, 1], [1, 0, 0], atol=1e-12)  # forward to the right


def test_disparity_is_focal_length_over_depth() -> None:
    points = np.array([[0.3, -0.2, 4.0], [1.5, 0.7, 20.0]])
    left, right = (CAMERA.project(points, view) for view in (0, 1))
    np.testing.assert_allclose(left[:, 0] - right[:, 0], 200 / points[:, 2])
    np.testing.assert_allclose(left[:, 1], right[:, 1])
    rays = CAMERA.rays @ np.append(left[0], 1)
    np.testing.assert_allclose(rays / (200 / 4.0), points[0])


def test_a_window_covers_the_hull_and_stays_in_the_image() -> None:
    hull = np.array([[-0.1, -0.1, 2.0], [0.1, 0.1, 2.0]])
    assert CAMERA.window(hull, 0) == Window(86, 54, 107, 75)
    wide = np.array([[-9.0, -9.0, 2.0], [9.0, 9.0, 2.0]])
    assert CAMERA.window(wide, 0) == Window(0, 0, 192, 128)
    assert CAMERA.window(hull + np.array([9.0, 0, 0]), 0) is None
    assert CAMERA.window(hull * [1, 1, NEAREST / 3], 0) is None


def test_windows() -> None:
    window = Window(3, 5, 10, 9)
    image = np.arange(20 * 20).reshape(20, 20)
    assert window.size == image[window.slices].shape[::-1] == (7, 4)
    x, y = window.grid
    assert (x.min(), x.max(), y.min(), y.max()) == (3, 9, 5, 8)
    inner = Window(4, 6, 6, 8)
    assert np.array_equal(image[window.slices][inner.within(window)], image[inner.slices])
    np.testing.assert_array_equal(window.shift @ [1, 2, 1], [4, 7, 1])
