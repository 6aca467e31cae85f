"""Pictures of a board and of a textured wall, as two cameras with distortion that is known would take them."""

from __future__ import annotations

import cv2
import numpy as np

from anynet.camera import Camera, StereoRig

SIZE = 640, 480
SUPER = 2  # samples per pixel, each way


def rig() -> StereoRig:
    """Two unequal cameras with distortion, turned against each other."""
    left = np.array([[520.0, 0, 322.5], [0, 521.0, 238.0], [0, 0, 1]])
    right = np.array([[514.0, 0, 316.0], [0, 515.0, 244.5], [0, 0, 1]])
    rotation = cv2.Rodrigues(np.array([0.01, -0.03, 0.012]))[0]
    place = np.array([0.11, 0.002, -0.004])  # of the right camera
    return StereoRig(
        Camera(left, np.array([-0.28, 0.09, 0.0004, -0.0003, 0.0])),
        Camera(right, np.array([-0.27, 0.085, -0.0003, 0.0005, 0.0])),
        rotation,
        -rotation @ place,
        SIZE,
    )


def rays(camera: Camera, size: tuple[int, int] = SIZE) -> np.ndarray:
    """The direction of every sample of every pixel, [H * SUPER, W * SUPER, 3]."""
    columns, rows = np.meshgrid(*((np.arange(n * SUPER) + 0.5) / SUPER - 0.5 for n in size))
    seen_x = (columns - camera.matrix[0, 2]) / camera.matrix[0, 0]
    seen_y = (rows - camera.matrix[1, 2]) / camera.matrix[1, 1]
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = seen_x, seen_y
    for _ in range(30):  # the distortion's inverse, as a fixed point
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        x, y = (
            (seen_x - 2 * p1 * x * y - p2 * (square + 2 * x * x)) / radial,
            (seen_y - p1 * (square + 2 * y * y) - 2 * p2 * x * y) / radial,
        )
    return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)


def view(
    directions: np.ndarray, rotation: np.ndarray, translation: np.ndarray, texture: np.ndarray, scale: float
) -> np.ndarray:
    """A plane z = 0 with a texture (`scale` texels per meter), as seen from x_camera = rotation @ x + translation."""
    ray = directions @ rotation.astype(np.float32)  # in the plane's frame
    origin = -rotation.T @ translation
    at = origin[:2] + ray[..., :2] * (-origin[2] / ray[..., 2:])
    places = (at * scale - 0.5).astype(np.float32)
    image = cv2.remap(texture, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderValue=(127, 127, 127))
    small = cv2.resize(image, None, fx=1 / SUPER, fy=1 / SUPER, interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(0).normal(0, 1.5, small.shape)
    return np.clip(small + noise, 0, 255).astype(np.uint8)


def chessboard(columns: int, rows: int, square: float) -> tuple[np.ndarray, float, np.ndarray]:
    """A texture with its board, texels per meter, and where the first inner corner lies, meters."""
    texels = 40
    cells = np.indices((rows + 1, columns + 1)).sum(axis=0) % 2
    board = np.kron(cells, np.ones((texels, texels))).astype(np.uint8) * 200 + 30
    board = cv2.copyMakeBorder(board, texels, texels, texels, texels, cv2.BORDER_CONSTANT, value=230)
    return np.repeat(board[..., None], 3, axis=2), texels / square, np.array([2 * square, 2 * square, 0])


def poses(count: int, middle: np.ndarray, seed: int = 1) -> list[tuple[np.ndarray, np.ndarray]]:
    """Poses of a board (its middle given, meters) before the left camera: near and far, tilted, everywhere."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        rotation = cv2.Rodrigues(rng.uniform(-0.55, 0.55, 3) * [1, 1, 0.6])[0]
        depth = rng.uniform(0.3, 0.6)
        place = np.array([rng.uniform(-0.26, 0.34) * depth, rng.uniform(-0.24, 0.24) * depth, depth])
        found.append((rotation, place - rotation @ middle))
    return found


def pairs(texture: np.ndarray, scale: float, middle: np.ndarray, count: int, true: StereoRig | None = None) -> list:
    """Left and right images of the board in `count` poses."""
    true = true or rig()
    directions = [rays(camera) for camera in (true.left, true.right)]
    images = []
    for rotation, translation in poses(count, middle):
        left = view(directions[0], rotation, translation, texture, scale)
        right = view(
            directions[1], true.rotation @ rotation, true.rotation @ translation + true.translation, texture, scale
        )
        images.append((left, right))
    return images
