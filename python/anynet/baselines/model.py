"""A baseline as training, evaluation and files see it: a configuration, weights, and images of any size."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from anynet.baselines.baseline import Baseline
from anynet.baselines.dispnet import DispNetC
from anynet.baselines.psmnet import PSMNet, PSMNetBasic
from anynet.baselines.stereodnn import NVTiny, ResNet18Correlation
from anynet.baselines.stereonet import StereoNet
from anynet.checkpoint import check_tensors, find_weights, read_safetensors, stored_object
from anynet.device import find_device
from anynet.errors import AnyNetError
from anynet.frame import check_images
from anynet.model.anynet import normalize, resized
from anynet.model.bounds import check_input_scale
from anynet.predictor import Estimate, inference
from anynet_ext import resize

MODELS: dict[str, Callable[[int], Baseline]] = {
    "psmnet": PSMNet,
    "psmnet-basic": PSMNetBasic,
    "stereonet-8x": StereoNet,
    "stereonet-16x": partial(StereoNet, halvings=4),
    "dispnetc": DispNetC,
    "resnet18-2d": ResNet18Correlation,
    "nvtiny": NVTiny,
}
"""From a name and the largest disparity, in pixels of the images given, to a network with random weights."""


@dataclass(frozen=True, kw_only=True)
class BaselineConfig:
    """Which baseline, and for what images.

    Args:
        model: a name in `MODELS`.
        max_disparity: the disparities told apart reach from 0 to this, in pixels of the images as they come.
        input_scale: the images are resized by this factor first, and estimates, bilinearly, back.

    Raises:
        AnyNetError: if there is no such model, or a number is out of its bounds.
    """

    model: str
    max_disparity: int = 192
    input_scale: float = 1

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise AnyNetError(f"expected a model of {', '.join(MODELS)}, got {self.model!r}")
        if type(self.max_disparity) is not int or not 1 <= self.max_disparity <= 1024:
            raise AnyNetError(f"BaselineConfig: expected max_disparity from 1 to 1024, got {self.max_disparity!r}")
        check_input_scale(self, self.input_scale)


class BaselineModel(nn.Module):
    """A baseline on images that are resized first, as its configuration says."""

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__()
        self.config = config
        self.network = MODELS[config.model](math.ceil(config.max_disparity * config.input_scale))

    @property
    def loss_weights(self) -> tuple[float, ...]:
        """Of the estimates in training, the final one last."""
        return self.network.loss_weights

    def forward(self, left: Tensor, right: Tensor, stages: int | None = None) -> list[Tensor]:
        """The estimates, as `Baseline.forward`; at most the first `stages` of them.

        Args:
            left, right: [N, 3, H, W], normalized, of the size and the pixels that the estimates have.
        """
        height, width = left.shape[2:]
        scale = self.config.input_scale
        if scale == 1:
            estimates: list[Tensor] = self.network(left, right)
            return estimates[:stages]
        left, right = (resized(image, scale) for image in (left, right))
        small: list[Tensor] = self.network(left, right)[:stages]
        return [resize(estimate, (height, width), scale=width / left.shape[3]) for estimate in small]


class BaselinePredictor:
    """A baseline ready to use, as `anynet.Predictor`: images in bytes in, its only estimate out.

    Args:
        model: with its weights.
        device: "cpu", "cuda", "cuda:N" or "auto", as `Predictor`'s.
        threads: CPU threads to compute on; default: as many as PyTorch uses.

    Raises:
        AnyNetError: if the device is not there.
    """

    def __init__(self, model: BaselineModel, *, device: str = "cpu", threads: int | None = None) -> None:
        self.device, self.threads = find_device(device), threads
        self.model = model.eval().to(self.device)

    def stages(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Iterator[Estimate]:
        """One estimate, stage 1, of a rectified pair, [H, W, 3] uint8 RGB.

        Raises:
            AnyNetError: if the images are not that.
        """
        start = perf_counter()
        images = check_images(left, right)
        with inference(self.device, self.threads):
            inputs = (normalize(image.to(self.device).permute(2, 0, 1)[None]).contiguous() for image in images)
            disparity = self.model(*inputs)[-1][0, 0].cpu().numpy()
        yield Estimate(1, disparity, 1e3 * (perf_counter() - start))


def stored_config(path: Path) -> BaselineConfig | None:
    """The configuration in a .safetensors file of a baseline's weights; None if the file is another network's."""
    try:
        with safe_open(path, "pt") as file:
            options = stored_object(file.metadata() or {}, "config")
    except (OSError, SafetensorError, KeyError, ValueError, RecursionError):
        return None
    try:
        return BaselineConfig(**options) if "model" in options else None
    except TypeError:
        return None
    except AnyNetError as error:
        raise AnyNetError(f"{path}: {error}") from None


def random_baseline(model: str, input_scale: float | None = None) -> BaselineModel:
    """The baseline of that name with random weights, on images as they are unless `input_scale` says otherwise."""
    return BaselineModel(BaselineConfig(model=model, input_scale=1 if input_scale is None else input_scale))


def load_baseline(path: str | os.PathLike[str], input_scale: float | None = None) -> BaselineModel:
    """The baseline with its weights, in eval mode, on the CPU.

    Args:
        path: of a .safetensors file that training or `anynet.checkpoint.save_checkpoint` wrote.
        input_scale: None; other networks take one, a baseline has its own.

    Raises:
        AnyNetError: if it is not that, or not all of it is finite, or there is an `input_scale`.
    """
    path = find_weights(path)
    config = stored_config(path)
    if config is None:
        raise AnyNetError(f"{path}: expected weights of a baseline ({', '.join(MODELS)}), got another file")
    if input_scale is not None:
        raise AnyNetError(f"{path}: expected no input_scale with a baseline's weights, got {input_scale:g}")
    try:
        _, tensors = read_safetensors(path)
    except OSError as error:
        raise AnyNetError(f"{path}: cannot be read: {error.strerror}") from None
    model = BaselineModel(config)
    check_tensors(path, config, tensors, model.state_dict())
    model.load_state_dict(tensors)
    return model.eval()
