from __future__ import annotations

import numpy as np
import pytest

from anynet.synthetic.geometry import Camera, rotation
from anynet.synthetic.renderer import draw
from anynet.synthetic.scene import Scene, log_uniform, tone

CAMERA = Camera(192, 128, 200.0, 96.0, 64.0)


def scene(seed: int = 0) -> Scene:
    return Scene(np.random.default_rng(seed), CAMERA, rotation(0, 0.05, 0.02))


def test_at_is_the_point_of_a_pixel() -> None:
    tilted = scene()
    point = tilted.tilt @ tilted.at(50.0, 90.0, 20.0)
    np.testing.assert_allclose(CAMERA.project(point[None], 0)[0], [50, 90])
    assert 200 / point[2] == pytest.approx(20)


def test_random_draws() -> None:
    rng = np.random.default_rng(0)
    drawn = np.array([log_uniform(rng, 0.5, 8.0) for _ in range(500)])
    assert 0.5 <= drawn.min() < 0.6
    assert 7 < drawn.max() <= 8
    assert np.median(drawn) == pytest.approx(2, rel=0.2)
    assert np.ptp(tone(rng, weak=True)[:, 0, 0].astype(int)) < 0.5 * np.ptp(tone(rng)[:, 0, 0].astype(int))
    rising, falling = tone(rng)[:, 0, 0].astype(int), tone(rng, negative=True)[:, 0, 0].astype(int)
    assert rising[-1] > rising[0]
    assert falling[-1] < falling[0]


def test_a_box_has_the_faces_that_a_camera_sees() -> None:
    corner = scene()
    corner.box(np.array([3.0, 3.0, 10.0]), (1, 1, 1), np.eye(3), ("bricks",), 1.0)
    assert len(corner.surfaces) == 3  # front, left and top, from the upper left
    ahead = scene()
    ahead.box(np.array([0.5, 0.5, 10.0]), (3, 1, 1), np.eye(3), ("bricks",), 1.0)
    assert len(ahead.surfaces) == 1


def test_a_tube_ends_at_its_ends() -> None:
    straight = Scene(np.random.default_rng(0), CAMERA)
    start, end = np.array([-1.0, -0.5, 9.0]), np.array([1.0, 0.5, 11.0])
    straight.tube(start, end, 0.1, straight.material(("plain",), 1.0))
    disparity = draw(straight, 0)[1]
    y, x = np.nonzero(disparity)
    for point in (start, end):
        pixel = CAMERA.project(point[None], 0)[0]
        assert np.hypot(x - pixel[0], y - pixel[1]).min() < 2
    assert disparity.max() == pytest.approx(200 / 9, rel=0.03)
    assert disparity[disparity > 0].min() == pytest.approx(200 / 11, rel=0.03)


def test_a_shadow_darkens_the_ground_and_keeps_its_disparity() -> None:
    images = []
    for dark in (False, True):
        ground = Scene(np.random.default_rng(1), CAMERA)
        ground.patch(np.array([-20, 1.0, 2]), np.array([40.0, 0, 0]), np.array([0, 0, 40.0]),
                     ground.material(("noise",), 4.0))  # fmt: skip
        if dark:
            ground.shadow(np.array([0, 1.0, 6.0]), 4.0, 4.0)
        images.append(draw(ground, 0))
    (bright, before), (shaded, after) = images
    assert shaded.mean() < bright.mean() - 1
    np.testing.assert_allclose(after, before, rtol=0.02)
