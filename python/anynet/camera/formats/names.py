"""Fields by the many names that people give them: K1, cameraMatrix1, Camera_Matrix_Left, left: {K: ...}, ..."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from anynet.camera.formats.found import Matrix, one_size
from anynet.camera.tree import Tree, number, numbers, walk
from anynet.camera.units import meters_per
from anynet.errors import AnyNetError

Named = tuple[str, Tree]

_UNITS = {
    "meter": "m", "decimeter": "dm", "millimeter": "mm", "centimeter": "cm", "micrometer": "um", "micron": "um",
    "inche": "in", "inch": "in", "feet": "ft", "foot": "ft",
}  # fmt: skip

_SIDES = (
    ("1", "2"), ("left", "right"), ("l", "r"), ("0", "1"), ("cam0", "cam1"), ("cam1", "cam2"), ("camera0", "camera1"),
    ("camera1", "camera2"), ("leftcamera", "rightcamera"), ("cameraleft", "cameraright"), ("camleft", "camright"),
    ("leftcam", "rightcam"), ("caml", "camr"), ("first", "second"), ("master", "slave"), ("a", "b"),
)  # fmt: skip
_NOT_OF_CAMERAS = ("board", "pattern", "square", "chess", "marker", "target", "corner", "validpix")
_COEFFICIENTS = ("k1", "k2", "p1", "p2")  # of a lens, a number each, and not the matrices K1, K2, P1, P2
_OF_A_RIG = ("stereo", "extrinsic", "pose", "transform", "relative")
_SENSORS = (
    "imu", "accel", "gyro", "lidar", "velo", "laser", "color", "rgb", "body", "base", "world", "robot", "gps", "depth",
    "projector", "ground",
)  # fmt: skip
_SIZES = ("imageSize", "imgSize", "size", "imageResolution", "resolution", "res", "frameSize", "calibrationSize")
_SHAPES = ("imageShape", "imgShape", "shape", "frameShape")  # as arrays have it: height, width
_SIDE_LENGTHS = (
    ("imageWidth", "imageHeight"), ("width", "height"), ("imgWidth", "imgHeight"), ("frameWidth", "frameHeight"),
    ("w", "h"), ("cameraWidth", "cameraHeight"), ("resolutionX", "resolutionY"), ("resX", "resY"),
)  # fmt: skip


class Names:
    """The fields of a tree; capitals, underscores and the like do not count, and outer maps' names may be left out.

    Args:
        tree: as a file holds them.
        matrices: names that camera matrices may have, by which maps of further cameras are known.
    """

    def __init__(self, tree: Tree, matrices: Sequence[str]) -> None:
        self._fields = [
            (path, node)
            for path, node in walk(tree)
            if not any(word in plain(name) for name in path for word in _NOT_OF_CAMERAS)
            and not (path[-1] in _COEFFICIENTS and number(node) is not None)
        ]
        self._nodes = _by_name(self._fields)
        maps = {name for name, (_, node) in self._nodes.items() if _is_map(node)}
        self._cameras = [sides for sides in _SIDES if {*sides} <= maps]
        inner = {side for sides in self._cameras for side in sides}
        around = {path[:-1] for path, node in self._fields if plain(path[-1]) in inner and _is_map(node)} | {()}
        self._inside: dict[str, dict[str, Named]] = {side: {} for side in inner}
        self._outside: dict[str, Named] = {}
        self._elsewhere: dict[str, Named] = {}
        for path, node in self._fields:
            if _is_map(node):  # even if it is called R
                continue
            holders = [plain(name) for name in path[:-1]]
            sides = [i for i, name in enumerate(holders) if name in inner]
            own = holders[sides[-1] + 1 :] if sides else holders
            neutral = not own or (len(own) == 1 and _is_neutral(own[0]))
            if sides and neutral:
                place = self._inside[holders[sides[-1]]]
            elif not sides and (neutral or path[:-1] in around):
                place = self._outside
            else:
                place = self._elsewhere
            place.setdefault(plain(path[-1]), (path[-1], node))
        named = {plain(name) for name in matrices}
        self._further = {
            path
            for path, node in self._fields
            if inner and inner.isdisjoint(map(plain, path)) and isinstance(node, dict)
            and not named.isdisjoint(map(plain, node))
        }  # fmt: skip

    def one(self, bases: Sequence[str]) -> Named | None:
        """The first of these fields that is there."""
        return _first(self._nodes, bases)

    def of_the_rig(self, bases: Sequence[str]) -> Named | None:
        """The first of these fields that is there beside the cameras, or in a map such as `stereo`."""
        return _first(self._outside, bases)

    def of_anything(self, bases: Sequence[str]) -> Named | None:
        """The first of these fields in other maps: it may be the rig's, or that of another sensor."""
        return _first(self._elsewhere, bases)

    def all(self, bases: Sequence[str]) -> list[Named]:
        """Every field of these names, with a side before or behind or without one; but for those of further cameras."""
        names = [plain(base) for base in bases]
        sides = {side for pair in _SIDES for side in pair}
        wanted = {*names, *(both for name in names for side in sides for both in (name + side, side + name))}
        return [
            (path[-1], node)
            for path, node in self._fields
            if plain(path[-1]) in wanted and not any(path[: len(other)] == other for other in self._further)
        ]

    def pair(self, bases: Sequence[str]) -> tuple[Named, Named] | None:
        """The left and the right camera's field.

        Raises:
            AnyNetError: if only one of them is there.
        """
        half: tuple[str, str] | None = None
        for base in bases:
            for sides in _SIDES:
                for names in ([plain(base + side) for side in sides], [plain(side + base) for side in sides]):
                    there = [name in self._nodes for name in names]
                    if all(there):
                        return self._nodes[names[0]], self._nodes[names[1]]
                    if any(there) and half is None and sides not in (("0", "1"), ("a", "b")):
                        half = base + sides[there.index(False)], self._nodes[names[there.index(True)]][0]
        if half is not None:
            raise AnyNetError(f"the calibration lacks {half[0]} beside {half[1]}")
        return None

    def of_each(self, bases: Sequence[str]) -> tuple[Named | None, Named | None]:
        """The field inside the left and inside the right camera's map."""
        either: tuple[Named | None, Named | None] = None, None
        for base in bases:
            for sides in self._cameras:
                left, right = (self._inside[side].get(plain(base)) for side in sides)
                if left is not None and right is not None:
                    return left, right
                if either == (None, None):
                    either = left, right
        return either

    def size(self) -> tuple[int, int] | None:
        """Width and height of the images, if told.

        Raises:
            AnyNetError: if the two cameras' differ.
        """
        pairs = [(self._size(left), self._size(right)) for left, right in _SIDES[:4]]
        return next((size for pair in pairs if (size := one_size(*pair))), self._size(""))

    def _size(self, side: str) -> tuple[int, int] | None:
        """That of one side, or told without a side."""
        for names, order in ((_SIZES, 1), (_SHAPES, -1)):
            for name in names:
                found = self.one([name + side, side + name])
                if found is not None and (size := _size(*found)[::order]):
                    return size[0], size[1]
        for width, height in _SIDE_LENGTHS:
            pair = self.one([width + side, side + width]), self.one([height + side, side + height])
            if pair[0] is not None and pair[1] is not None:
                return _length(*pair[0]), _length(*pair[1])
        return None

    def meters(self) -> float | None:
        """Meters per unit, if the file says it.

        Raises:
            AnyNetError: if it names another unit than `METERS` has.
        """
        found = self.one(["unit", "units", "lengthUnit", "baselineUnit", "translationUnit"])
        if found is None or not isinstance(found[1], str):
            return None
        name = found[1].strip().lower().removesuffix("s").replace("metre", "meter")
        return meters_per(_UNITS.get(name, name))

    def texts(self, *names: str) -> list[str]:
        """The texts of all these fields (see `all`) in lower case."""
        return [str(node).lower() for _, node in self.all(names) if isinstance(node, (str, bool))]


def _is_map(node: Tree) -> bool:
    return isinstance(node, dict) and "data" not in node  # no matrix


def _is_neutral(name: str) -> bool:
    """Whether a map of that name tells how the cameras stand to each other, not where another sensor is."""
    return name == "rig" or (any(word in name for word in _OF_A_RIG) and not any(word in name for word in _SENSORS))


def _by_name(fields: Iterable[tuple[tuple[str, ...], Tree]]) -> dict[str, Named]:
    named: dict[str, Named] = {}
    for path, node in fields:
        for start in range(len(path)):
            named.setdefault(plain("".join(path[start:])), (path[-1], node))
    return named


def _first(nodes: dict[str, Named], bases: Sequence[str]) -> Named | None:
    return next((nodes[plain(base)] for base in bases if plain(base) in nodes), None)


def matrix(named: Named, rows: int, columns: int) -> Matrix:
    """The field as a matrix.

    Raises:
        AnyNetError: if it is not one of that shape.
    """
    name, node = named
    values = numbers(node, name)
    if values.size != rows * columns:
        raise AnyNetError(f"expected {name} to be a matrix of {rows} x {columns}, got {values.size} numbers")
    return values.reshape(rows, columns)


def whole(value: float, name: str) -> int:
    """A whole number of pixels.

    Raises:
        AnyNetError: if it is none.
    """
    if not (np.isfinite(value) and 1 <= value <= 1e6):
        raise AnyNetError(f"expected {name} from 1 to 1000000, got {value:g}")
    return int(value)


def _size(name: str, node: Tree) -> tuple[int, ...]:
    if _is_map(node):
        return ()  # a map of width and height: found by their names
    values = numbers(node, name)
    return tuple(whole(value, name) for value in values[:2]) if values.size in (2, 3) else ()


def _length(name: str, node: Tree) -> int:
    return whole(float(numbers(node, name, 1)[0]), name)


def plain(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())
