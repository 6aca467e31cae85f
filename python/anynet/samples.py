"""What every data set hands out, and what the renderer makes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

MAX_DISPARITY = 192.0  # pixels; larger ones neither train nor count in an evaluation


@dataclass(frozen=True)
class StereoSample:
    """A rectified pair with the disparity of its left view.

    left, right: uint8 [H, W, 3], RGB. Left pixel (y, x) shows what right pixel (y, x - disparity) shows.
    disparity: float32 [H, W], pixels; NaN where unknown, unless `valid` says otherwise no value is to be used.
    valid: bool [H, W], where the disparity is known.
    noc: bool [H, W], where it is known and the right camera sees the point; None if the data do not say.
    foreground: bool [H, W], objects as against background; None if the data do not say.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    disparity: NDArray[np.float32]
    valid: NDArray[np.bool_]
    noc: NDArray[np.bool_] | None = None
    foreground: NDArray[np.bool_] | None = None
    name: str = ""


@dataclass(frozen=True, kw_only=True)
class RenderedSample(StereoSample):
    """A pair with dense ground truth for both views.

    disparity, right_disparity: float32 [H, W], pixels, the nearest surface that is more opaque than not.
    occluded, right_occluded: bool [H, W], what the other view does not show (outside its image included).
    """

    right_disparity: NDArray[np.float32]
    occluded: NDArray[np.bool_]
    right_occluded: NDArray[np.bool_]


class Dataset(Sequence[StereoSample]):
    """Pairs on disk (or made on demand), read one at a time; `name` says which set it is."""

    name: str

    @overload
    def __getitem__(self, index: int) -> StereoSample: ...
    @overload
    def __getitem__(self, index: slice) -> Dataset: ...
    def __getitem__(self, index: int | slice) -> StereoSample | Dataset:
        if isinstance(index, slice):
            return Concatenation(self.name, [(self, i) for i in range(*index.indices(len(self)))])
        if not -len(self) <= index < len(self):
            raise IndexError(f"{self.name}: no sample {index}, there are {len(self)}")
        return self.load(index % len(self))

    @abstractmethod
    def load(self, index: int) -> StereoSample:
        """Reads sample number `index`, 0 <= index < len(self)."""


class Concatenation(Dataset):
    """Chosen samples of other data sets, in a given order."""

    def __init__(self, name: str, places: Sequence[tuple[Dataset, int]]) -> None:
        self.name = name
        self._places = list(places)

    def __len__(self) -> int:
        return len(self._places)

    def load(self, index: int) -> StereoSample:
        dataset, place = self._places[index]
        return dataset.load(place)
