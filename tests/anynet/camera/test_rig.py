from __future__ import annotations

import cv2
import numpy as np
import pytest

from anynet.camera import Camera, StereoRig
from anynet.errors import AnyNetError

from . import rendering

EYE = np.eye(3)
K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])


def plain(**changes: object) -> StereoRig:
    values = {"left": Camera(K, np.zeros(0)), "right": Camera(K, np.zeros(0)), "rotation": EYE}
    values |= {"translation": np.array([-0.1, 0, 0]), "size": (640, 480), **changes}
    return StereoRig(**values)  # type: ignore[arg-type]


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    """OpenCV's pinhole model, written down once more."""
    x, y = (points[:, :2] / points[:, 2:]).T
    k1, k2, p1, p2, k3 = camera.distortion
    r = x * x + y * y
    radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
    u = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    v = y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y
    return np.stack([u, v], axis=1) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


@pytest.mark.parametrize("alpha", [None, 0.0, 1.0])
def test_points_in_space_get_their_depth_back(alpha: float | None) -> None:
    """Through the maps, a point's two raw pixels lie in one row, and their disparity gives its depth."""
    rig = rendering.rig()
    rectification = rig.rectify(alpha)
    calibration = rectification.calibration
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(-0.3, 0.3, 60), rng.uniform(-0.25, 0.25, 60), rng.uniform(1, 3, 60)], axis=1)
    in_right = points @ rig.rotation.T + rig.translation
    places = []
    for camera, seen, maps in zip((rig.left, rig.right), (points, in_right), rectification.maps, strict=True):
        raw = project(camera, seen)
        distances = [np.hypot(maps[0] - u, maps[1] - v) for u, v in raw]
        nearest = [np.unravel_index(np.argmin(d), d.shape) for d in distances]
        assert max(d.min() for d in distances) < 1.5
        places.append(np.array(nearest, float)[:, ::-1])
    assert np.abs(places[0][:, 1] - places[1][:, 1]).max() <= 1
    disparity = places[0][:, 0] - places[1][:, 0]
    forward = (points @ rectification.rotations[0].T)[:, 2]  # in the rectified camera's frame
    expected = calibration.focal * calibration.baseline / forward - calibration.doffs
    assert np.abs(disparity - expected).max() <= 1.01  # both ends are rounded to pixels
    assert calibration.baseline == pytest.approx(rig.baseline)


def test_rectified_images_have_their_corners_in_one_row() -> None:
    from anynet.camera import check_rectified, match_corners

    texture = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8).repeat(12, 0).repeat(12, 1)
    scale = texture.shape[1] / 1.6
    middle = np.array([texture.shape[1], texture.shape[0], 0]) / scale / 2
    ((left, right),) = wall(texture, scale, middle)
    raw = match_corners(left, right)
    assert raw.rows_apart > 1
    rectification = rendering.rig().rectify()
    pair = rectification(left, right)
    matches = match_corners(*pair)
    assert matches.enough
    assert matches.rows_apart < 0.3
    assert check_rectified(*pair) == []
    black = (pair[0] == 0).all(axis=2)
    assert (rectification.valid <= ~black).mean() > 0.99


def wall(texture: np.ndarray, scale: float, middle: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """A wall across the view, 1 m away."""
    rig = rendering.rig()
    place = np.array([0.02, 0, 1.0]) - middle
    images = []
    for camera, rotation, translation in (
        (rig.left, EYE, place), (rig.right, rig.rotation, rig.rotation @ place + rig.translation)
    ):  # fmt: skip
        images.append(rendering.view(rendering.rays(camera), rotation, translation, texture, scale))
    return [(images[0], images[1])]


def test_what_is_rectified_already() -> None:
    assert plain().is_rectified
    assert not rendering.rig().is_rectified
    assert not plain(translation=np.array([-0.1, 0.001, 0])).is_rectified
    assert not plain(right=Camera(K + np.array([[0, 0, 0], [0, 0, 2], [0, 0, 0]]), np.zeros(0))).is_rectified
    assert not plain(left=Camera(K, np.array([0.01, 0, 0, 0]))).is_rectified
    turn = cv2.Rodrigues(np.array([0, 4.8e-4, 0]))[0]  # a quarter of a pixel of disparity here, more than one there
    assert plain(rotation=turn).is_rectified
    far = K * [[5, 1, 1], [1, 5, 1], [1, 1, 1]]
    assert not plain(rotation=turn, left=Camera(far, np.zeros(0)), right=Camera(far, np.zeros(0))).is_rectified


def test_nothing_is_seen_twice() -> None:
    """Where radial distortion turns back, rays beyond would find pixels that nearer ones have shown."""
    camera = Camera(np.array([[300.0, 0, 320], [0, 300, 240], [0, 0, 1]]), np.array([-0.35, 0.15, 0, 0, -0.03]))
    rectification = plain(left=camera, right=camera).rectify(1)
    calibration, (x, y) = rectification.calibration, rectification.maps[0]
    v, u = np.mgrid[: x.shape[0], : x.shape[1]]
    r = np.hypot(u - calibration.cx, v - calibration.cy) / calibration.focal
    distorted = np.hypot(x - 320, y - 240) / 300
    order = np.argsort(r[rectification.valid])
    assert np.diff(distorted[rectification.valid][order]).min() > -1e-3
    assert 0.7 < rectification.valid.mean() < 0.8
    image = np.full((480, 640, 3), 255, np.uint8)
    assert not rectification(image, image)[0][~rectification.valid & (r > 2)].any()


def test_another_baseline() -> None:
    assert plain().with_baseline(0.2).translation == pytest.approx([-0.2, 0, 0])
    with pytest.raises(AnyNetError, match="expected baseline > 0, got -1"):
        plain().with_baseline(-1)
    with pytest.raises(AnyNetError, match=r"expected two cameras apart, .*, got a translation of 0"):
        plain(translation=np.zeros(3)).with_baseline(0.2)


def test_exchanged_twice_is_the_same() -> None:
    rig = rendering.rig()
    again = rig.exchanged().exchanged()
    np.testing.assert_allclose(again.translation, rig.translation, atol=1e-12)
    np.testing.assert_allclose(again.rotation, rig.rotation, atol=1e-12)
    with pytest.raises(AnyNetError, match="expected the left camera first"):
        rig.exchanged().rectify()


def test_fisheye() -> None:
    camera = Camera(K, np.array([0.02, -0.01, 0.0, 0.0]), "fisheye")
    calibration = plain(left=camera, right=camera).rectify().calibration
    assert calibration.baseline == pytest.approx(0.1)
    assert calibration.doffs == pytest.approx(0, abs=1e-6)
    with pytest.raises(AnyNetError, match="two cameras of one model"):
        plain(left=camera).rectify()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"translation": np.array([0, -0.1, 0])}, "one above the other .* counterclockwise"),
        ({"translation": np.array([0, 0.1, 0])}, "one above the other .* 90 degrees clockwise"),
        ({"translation": np.array([0, 0, 0.1])}, "one behind the other"),
        ({"translation": np.zeros(3)}, "expected two cameras apart"),
        ({"size": None}, "lacks the size"),
        ({"right": Camera(K + np.diag([1.0, 0], 1), np.zeros(0))}, "without skew, got 1 beside .* of 500"),
    ],
)
def test_what_cannot_be_rectified(changes: dict[str, object], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        plain(**changes).rectify()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotation": 2 * EYE}, "got a matrix that is none"),
        ({"rotation": np.diag([1.0, 1, -1])}, "got a matrix that is none"),
        ({"rotation": np.full((3, 3), np.nan)}, "expected a rotation of 3 x 3"),
        ({"translation": np.full(3, np.inf)}, "expected a translation"),
        ({"size": (0, 480)}, "expected an image size"),
    ],
)
def test_impossible_values(changes: dict[str, object], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        plain(**changes)


@pytest.mark.parametrize(
    ("matrix", "distortion", "model", "message"),
    [
        (np.diag([-1.0, 1, 1]), [], "pinhole", "focal lengths > 0"),
        (np.full((3, 3), np.nan), [], "pinhole", "focal lengths > 0"),
        (K.T, [], "pinhole", "rows end in 0 0 1"),
        (K, [1, 2, 3], "pinhole", "expected 4, 5, 8, 12, 14 distortion coefficients"),
        (K, [1, 2, 3, 4, 5], "fisheye", "expected 4 distortion coefficients"),
        (K, [np.nan] * 4, "pinhole", "expected finite distortion"),
        (K, [], "omni", "expected a camera model of pinhole or fisheye"),
    ],
)
def test_impossible_cameras(matrix: np.ndarray, distortion: list[float], model: str, message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        Camera(matrix, np.array(distortion), model)


def test_images_of_another_size() -> None:
    with pytest.raises(AnyNetError, match="expected images of 640 x 480 as the calibration says, got 64 x 48"):
        plain().rectify(size=(64, 48))
    image = np.zeros((48, 64, 3), np.uint8)
    with pytest.raises(AnyNetError, match="expected images of 640 x 480"):
        plain().rectify()(image, image)
