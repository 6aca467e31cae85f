"""Calibration boards: chessboards and ChArUco boards, and where their corners lie in an image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anynet.errors import AnyNetError

Image = npt.NDArray[np.uint8]
Points = npt.NDArray[np.float32]

DICTIONARIES = tuple(name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_"))


@dataclass(frozen=True)
class Corners:
    """Corners of a board in an image: their numbers [N] and places [N, 2], x and y, pixels."""

    numbers: npt.NDArray[np.int64]
    places: Points


@dataclass(frozen=True)
class Board:
    """A flat board.

    Attributes:
        columns, rows: of a chessboard its inner corners, of a ChArUco board its squares.
        square: side of a square, meters.
        marker: side of a marker, meters; 0 for a chessboard.
        dictionary: of the markers, such as 4X4_50.
    """

    columns: int
    rows: int
    square: float
    marker: float = 0.0
    dictionary: str = "4X4_50"

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 100 and 3 <= self.rows <= 100):
            raise AnyNetError(f"expected a board of 3 x 3 to 100 x 100, got {self.columns} x {self.rows}")
        if not 0 < self.square <= 10:
            raise AnyNetError(f"expected a square of 0 to 10 meters, got {self.square:g}: is it in millimeters?")
        if not 0 <= self.marker < self.square:
            raise AnyNetError(f"expected markers smaller than the squares of {self.square:g} m, got {self.marker:g}")
        if self.dictionary not in DICTIONARIES:
            raise AnyNetError(f"expected a dictionary of {', '.join(DICTIONARIES[:8])}, ..., got {self.dictionary}")

    @property
    def points(self) -> Points:
        """[M, 3] meters, all corners on the board, row by row."""
        columns, rows = (self.columns - 1, self.rows - 1) if self.marker else (self.columns, self.rows)
        grid = np.mgrid[0:columns, 0:rows].T.reshape(-1, 2) * self.square
        return np.hstack([grid, np.zeros((len(grid), 1))]).astype(np.float32)

    @property
    def patterns(self) -> tuple[bool, ...]:
        """Where markers may be: in today's squares, and in those before OpenCV 4.6 (`legacy`) if they are others."""
        return (False, True) if self.marker and self.rows % 2 == 0 else (False,)

    def find(self, image: Image, legacy: bool = False) -> Corners | None:
        """The corners seen in an image, uint8 [H, W, 3] RGB; None if the board is not found.

        A board that leaves the image may be taken for one of the other pattern, a square aside (see `find_view`).
        """
        gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
        return self._find_charuco(gray, legacy) if self.marker else self._find_chessboard(gray)

    def _find_chessboard(self, gray: Image) -> Corners | None:
        found, places = cv2.findChessboardCornersSB(gray, (self.columns, self.rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not found:
            return None
        return Corners(np.arange(self.columns * self.rows), np.asarray(places, np.float32).reshape(-1, 2))

    def _find_charuco(self, gray: Image, legacy: bool) -> Corners | None:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)
        board.setLegacyPattern(legacy)
        places, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(gray)
        if numbers is None or len(numbers) < 6:
            return None
        return Corners(np.asarray(numbers, np.int64).ravel(), np.asarray(places, np.float32).reshape(-1, 2))


@dataclass(frozen=True)
class View:
    """One pair of images of the board: the corners that both cameras see.

    Attributes:
        name: for reports.
        points: [N, 3] meters, on the board.
        left, right: [N, 2] pixels, in the images.
    """

    name: str
    points: Points
    left: Points
    right: Points

    def differs(self, other: View, pixels: float) -> bool:
        """Whether the board has moved by that much in the left image, on average."""
        centers = self.left.mean(axis=0) - other.left.mean(axis=0)
        spreads = self.left.std(axis=0) - other.left.std(axis=0)
        return bool(max(np.abs(centers).max(), 2 * np.abs(spreads).max()) > pixels)


def find_view(board: Board, name: str, left: Image, right: Image) -> View | str:
    """The view, or why there is none.

    Args:
        board: what to look for.
        name: for reports.
        left, right: uint8 [H, W, 3] RGB.
    """
    lacking = {"left", "right"}
    for legacy in board.patterns:  # one for both images, so that equal numbers are the same corner
        first, second = board.find(left, legacy), board.find(right, legacy)
        if first is not None and second is not None:
            break
        lacking &= {side for side, corners in (("left", first), ("right", second)) if corners is None}
    else:
        where = f"in the {' and the '.join(sorted(lacking))} image" if lacking else "of one pattern in both images"
        return f"no board {where}"
    numbers, at, there = np.intersect1d(first.numbers, second.numbers, return_indices=True)
    if len(numbers) < 6:
        return f"only {len(numbers)} corners in both images"
    lefts, rights = first.places[at], second.places[there]
    if not board.marker and float((lefts[-1] - lefts[0]) @ (rights[-1] - rights[0])) < 0:
        rights = rights[::-1].copy()  # found from the other end
    return View(name, board.points[numbers], lefts, rights)
