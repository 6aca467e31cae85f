from __future__ import annotations

import cv2
import numpy as np
import pytest

from anynet.camera.boards import Board, View, find_view


def drawn(columns: int, rows: int, legacy: bool) -> np.ndarray:
    """A ChArUco board on white, 100 pixels a square."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((columns, rows), 0.04, 0.03, dictionary)
    board.setLegacyPattern(legacy)
    gray = board.generateImage((100 * columns, 100 * rows))
    gray = cv2.copyMakeBorder(gray, 100, 100, 100, 100, cv2.BORDER_CONSTANT, value=255)
    return np.repeat(gray[..., None], 3, axis=2)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("rows", [6, 7])
@pytest.mark.parametrize("columns", [-350, 350])
def test_a_charuco_board_that_leaves_one_image(rows: int, legacy: bool, columns: int) -> None:
    """Cut off, a board of one pattern looks like one of the other a square aside: the whole one decides."""
    image = drawn(9, rows, legacy)
    cut = np.full_like(image, 255)
    if columns > 0:
        cut[:, :-columns] = image[:, columns:]
    else:
        cut[:, -columns:] = image[:, :columns]
    board = Board(9, rows, 0.04, 0.03)
    for pair, expected in (((image, cut), columns), ((cut, image), -columns), ((cut, cut), 0)):
        view = find_view(board, "a", *pair)
        assert isinstance(view, View)
        assert len(view.points) >= 3 * (rows - 1)
        np.testing.assert_allclose(view.left - view.right, np.broadcast_to([expected, 0], view.left.shape), atol=1)


def test_boards_of_two_patterns() -> None:
    board = Board(9, 6, 0.04, 0.03)
    pair = drawn(9, 6, False), drawn(9, 6, True)
    assert find_view(board, "a", *pair) == "no board of one pattern in both images"
    assert find_view(board, "a", pair[0], np.full_like(pair[0], 255)) == "no board in the right image"
