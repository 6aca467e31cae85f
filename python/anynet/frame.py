"""A pair of images on its way through the network, and what it gives at their size."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anynet.errors import AnyNetError
from anynet.model.confidence import HIDDEN, ConfidenceModel, gather_evidence, view_difference
from anynet.model.deploy import DeployedAnyNet, StageResult, sum_at


@dataclass(frozen=True)
class Maps:
    """A stage's results at the images' size; `trust` are the confidence and the occlusion, if asked for."""

    disparity: NDArray[np.float32]
    trust: dict[str, Any]


class Frame:
    """A pair on its way through the network: resized as its weights say, and mirrored for the right view.

    Of mirrored images, the right one is the left view.
    """

    def __init__(
        self,
        network: DeployedAnyNet,
        zoom: float,
        images: tuple[Tensor, Tensor],
        model: ConfidenceModel | None,
        left_right: bool,
        mirrored: bool,
    ) -> None:
        self._network, self._model, self._left_right, self._mirrored = network, model, left_right, mirrored
        self._zoom, self._images = zoom, images
        self._size = images[0].shape[:2]

    @property
    def kind(self) -> Hashable:
        """Frames of one kind take equally long."""
        return *self._size, self._model is not None, self._left_right

    def steps(self) -> Iterator[tuple[StageResult, StageResult | None]]:
        """The stages' results; with the left-right check, of the other view besides."""
        height, width = self._size
        images = self._images
        if self._zoom != 1:
            size = max(1, round(self._zoom * width)), max(1, round(self._zoom * height))
            interpolation = cv2.INTER_AREA if self._zoom < 1 else cv2.INTER_LINEAR
            first, second = (cv2.resize(image.numpy(), size, interpolation=interpolation) for image in images)
            images = torch.from_numpy(first), torch.from_numpy(second)
        if self._mirrored:
            images = _mirror(images)
        self._images, self._pixel = images, width / images[0].shape[1]
        views = [images, _mirror(images)] if self._left_right else [images]
        for results in zip(*(self._network.stages(*view) for view in views), strict=True):
            yield results[0], results[1] if self._left_right else None

    def maps(self, stage: int, result: StageResult, other: StageResult | None) -> Maps:
        disparity = result()
        trust: dict[str, Any] = {}
        if self._model is not None:
            evidence = gather_evidence(self._network, result, *self._images, self._pixel)
            size = self._images[0].shape[0], self._images[0].shape[1]
            if other is None:
                difference, hidden = None, sum_at([evidence.hidden], [evidence.scale], size)
            else:
                difference = view_difference(disparity, other().flip(1)).mul_(self._pixel)
                columns = torch.arange(size[1], dtype=disparity.dtype)
                hidden = torch.maximum(difference, (disparity - columns) * self._pixel)
                difference = difference.abs()
            trust["confidence"] = self._resized(self._model.probability(stage, evidence, size, difference))
            trust["occluded"] = self._resized(hidden) > HIDDEN
        return Maps(self._resized(disparity, self._pixel), trust)

    def _resized(self, values: Tensor, gain: float = 1.0) -> NDArray[np.float32]:
        """A map at the caller's size, in memory that is no tensor's: freeing a tensor takes the interpreter's lock
        again, and a daemon thread that waits for it at exit ends the process."""
        array: NDArray[Any] = values.numpy()
        if values.shape != self._size:
            height, width = self._size
            array = cv2.resize(array, (width, height)) * np.float32(gain)
        return (array[:, ::-1] if self._mirrored else array).copy()


def _mirror(images: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    left, right = images
    return right.flip(1), left.flip(1)


def check_images(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[Tensor, Tensor]:
    """The images as tensors [H, W, 3] that share their memory where possible."""
    for name, image in (("left", left), ("right", right)):
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            what = f"{image.dtype} {list(image.shape)}" if isinstance(image, np.ndarray) else type(image).__name__
            raise AnyNetError(f"expected {name} as uint8 RGB array [H, W, 3], got {what}")
    if left.shape != right.shape or left.size == 0:
        raise AnyNetError(f"expected two images of one size, got {list(left.shape)} and {list(right.shape)}")
    # PyTorch warns about arrays that are read-only, and cannot take negative strides.
    arrays = (np.require(image, requirements=["C", "W"]) for image in (left, right))
    first, second = (torch.from_numpy(array) for array in arrays)
    return first, second
