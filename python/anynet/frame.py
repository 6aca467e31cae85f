"""A pair of images on its way through the network, and what it gives at their size."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from anynet.errors import AnyNetError
from anynet.model.anynet import resized
from anynet.model.confidence import HIDDEN, ConfidenceModel, gather_evidence, view_difference
from anynet.model.deploy import DeployedAnyNet, StageResult, sum_at
from anynet.model.graphs import GraphedAnyNet

Image = NDArray[np.uint8] | Tensor


@dataclass(frozen=True)
class Maps:
    """A stage's results at the images' size; `trust` are the confidence and the occlusion, if asked for."""

    disparity: Any
    trust: dict[str, Any]


class Frame:
    """A pair on its way through the network: resized as its weights say, and mirrored for the right view.

    Of mirrored images, the right one is the left view. Arrays are resized on the CPU, tensors where they are.
    """

    def __init__(
        self,
        network: DeployedAnyNet | GraphedAnyNet,
        zoom: float,
        images: tuple[Tensor, Tensor],
        model: ConfidenceModel | None,
        left_right: bool,
        *,
        device: torch.device,
        mirrored: bool,
        as_arrays: bool,
    ) -> None:
        self._network, self._model, self._left_right, self._mirrored = network, model, left_right, mirrored
        self._zoom, self._images, self._device, self._as_arrays = zoom, images, device, as_arrays
        self._size = images[0].shape[:2]

    @property
    def kind(self) -> Hashable:
        """Frames of one kind take equally long."""
        return *self._size, self._model is not None, self._left_right, self._as_arrays

    def steps(self) -> Iterator[tuple[StageResult, StageResult | None]]:
        """The stages' results; with the left-right check, of the other view besides."""
        images = self._images
        if self._zoom != 1:
            images = self._zoomed(images[0]), self._zoomed(images[1])
        if self._mirrored:
            images = _mirror(images)
        if self._as_arrays and self._device.type != "cpu":
            images = images[0].to(self._device), images[1].to(self._device)
        self._images, self._pixel = images, self._size[1] / images[0].shape[1]
        views = [images, _mirror(images)] if self._left_right else [images]
        steps = zip(*[self._network.stages(*view) for view in views], strict=True)
        return ((results[0], results[1] if self._left_right else None) for results in steps)

    def maps(self, stage: int, result: StageResult, other: StageResult | None) -> Maps:
        """The results when they are there, in memory of their own."""
        array: Any = None  # into which the last operator writes, where it can
        if self._as_arrays and self._device.type == "cpu":
            array = np.empty(self._images[0].shape[:2], np.float32)
        disparity = result(None if array is None else torch.from_numpy(array))
        trust: dict[str, Any] = {}
        if self._model is not None:
            evidence = gather_evidence(self._network, result, *self._images, self._pixel)
            size = self._images[0].shape[0], self._images[0].shape[1]
            if other is None:
                difference, hidden = None, sum_at([evidence.hidden], [evidence.scale], size)
            else:
                difference = view_difference(disparity, other().flip(1)).mul_(self._pixel)
                columns = torch.arange(size[1], dtype=disparity.dtype, device=self._device)
                hidden = torch.maximum(difference, (disparity - columns) * self._pixel)
                difference = difference.abs()
            trust["confidence"] = self._resized(self._model.probability(stage, evidence, size, difference))
            trust["occluded"] = self._resized(hidden) > HIDDEN
        if array is None or self._mirrored or array.shape != tuple(self._size):
            array = self._resized(disparity, self._pixel)
        if not self._as_arrays:
            with torch.inference_mode(False):  # tensors that the caller may change, and compute gradients with
                array, trust = array.clone(), {name: values.clone() for name, values in trust.items()}
        maps = Maps(array, trust)
        if self._device.type == "cuda":
            torch.cuda.current_stream(self._device).synchronize()
        return maps

    def _zoomed(self, image: Tensor) -> Tensor:
        if not self._as_arrays:
            small = resized(image.permute(2, 0, 1)[None].float(), self._zoom).clamp_(0, 255)
            # As OpenCV: halves go up where it halves images, and to the even number elsewhere.
            halved = small.shape[2] * 2 == self._size[0] and small.shape[3] * 2 == self._size[1]
            small = small.add_(0.5).floor_() if halved else small.round_()
            return small[0].permute(1, 2, 0).to(torch.uint8).contiguous()
        height, width = self._size
        size = max(1, round(self._zoom * width)), max(1, round(self._zoom * height))
        interpolation = cv2.INTER_AREA if self._zoom < 1 else cv2.INTER_LINEAR
        return torch.from_numpy(cv2.resize(image.numpy(), size, interpolation=interpolation))

    def _resized(self, values: Tensor, gain: float = 1.0) -> Any:
        """A map at the caller's size. An array lies in memory that is no tensor's: freeing a tensor takes the
        interpreter's lock again, and a daemon thread that waits for it at exit ends the process."""
        if not self._as_arrays:
            if values.shape != self._size:
                values = gain * F.interpolate(values[None, None], self._size, mode="bilinear")[0, 0]
            return values.flip(1) if self._mirrored else values
        array: NDArray[Any] = values.cpu().numpy()
        if values.shape != self._size:
            height, width = self._size
            array = cv2.resize(array, (width, height)) * np.float32(gain)
        return (array[:, ::-1] if self._mirrored else array).copy()


def _mirror(images: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    left, right = images
    return right.flip(1), left.flip(1)


def check_images(left: Image, right: Image, device: torch.device | None = None) -> tuple[Tensor, Tensor]:
    """The images as tensors [H, W, 3] that share their memory where possible.

    Args:
        device: where images that are tensors must be; None: anywhere.

    Raises:
        AnyNetError: if they are not uint8 RGB images of one size, both arrays or both tensors on the device.
    """
    for name, image in (("left", left), ("right", right)):
        known = isinstance(image, (np.ndarray, Tensor))
        uint8 = np.uint8 if isinstance(image, np.ndarray) else torch.uint8
        if not known or image.dtype != uint8 or image.ndim != 3 or image.shape[2] != 3:
            what = f"{image.dtype} {list(image.shape)}" if known else type(image).__name__
            raise AnyNetError(f"expected {name} as uint8 RGB array [H, W, 3], got {what}")
        if isinstance(image, Tensor) and device is not None and image.device != device:
            raise AnyNetError(f"expected {name} as array, or tensor on {device}, got a tensor on {image.device}")
    if tuple(left.shape) != tuple(right.shape) or 0 in left.shape:
        raise AnyNetError(f"expected two images of one size, got {list(left.shape)} and {list(right.shape)}")
    if isinstance(left, Tensor) and isinstance(right, Tensor):
        return left.detach().contiguous(), right.detach().contiguous()
    if isinstance(left, Tensor) or isinstance(right, Tensor):
        raise AnyNetError("expected two arrays or two tensors, got one of each")
    return _as_tensor(left), _as_tensor(right)


def _as_tensor(array: NDArray[np.uint8]) -> Tensor:
    """PyTorch warns about arrays that are read-only, and cannot take negative strides."""
    flags = array.flags
    usable = flags.c_contiguous and flags.writeable and min(array.strides) >= 0  # that of a single row may be negative
    return torch.from_numpy(array if usable else array.copy())
