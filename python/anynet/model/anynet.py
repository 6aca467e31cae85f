"""AnyNet (Wang et al., ICRA 2019, arXiv 1810.11408): stereo depth in stages, each refining the one before."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.errors import AnyNetError
from anynet.model.config import MEAN, STD, AnyNetConfig
from anynet.model.features import SeparateFeatures, UNet
from anynet.model.first_stage import first_stage
from anynet.model.refinement import Refinement
from anynet.model.residual_stage import residual_stage
from anynet.scheduler import last_stage_of
from anynet_ext import resize


class AnyNet(nn.Module):
    """Disparity of a rectified pair, as a sequence of ever better estimates.

    The images are [N, 3, H, W] float tensors: RGB in 0..1, minus the ImageNet mean, over its standard deviation
    (`anynet.model.config.MEAN`, `STD`); any H and W. An estimate is [N, 1, H, W], in pixels: left pixel (y, x) is
    right pixel (y, x - d).
    """

    def __init__(self, config: AnyNetConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or AnyNetConfig()
        self.features = SeparateFeatures(config.features) if config.features.separate else UNet(config.features)
        self.first_stage = first_stage(config)
        self.residual_stages = nn.ModuleList(residual_stage(config, i) for i in range(config.features.blocks))
        self.refinement = Refinement(config.refinement, config.finest)

    def forward(self, left: Tensor, right: Tensor, stages: int | None = None) -> list[Tensor]:
        """The first `stages` estimates (default: all), each [N, 1, H, W]; differentiable."""
        last = last_stage_of("AnyNet", stages, self.config.stages, "stages")
        return list(islice(self.stages(left, right), last))

    def stages(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        """The estimates one by one; each is computed, its part of the U-Net included, when it is asked for.

        Raises:
            AnyNetError: when the first estimate is asked for, if the images are not of one shape [N, 3, H, W], or the
                weights are neither float32 nor float64.
        """
        if left.shape != right.shape or left.dim() != 4 or left.shape[1] != 3 or 0 in left.shape[2:]:
            raise AnyNetError(
                f"AnyNet: expected two images of one shape [N, 3, H, W], got {list(left.shape)} and {list(right.shape)}"
            )
        dtype = self.refinement.expand.weight.dtype
        if dtype not in (torch.float32, torch.float64):
            raise AnyNetError(
                f"AnyNet: expected weights of float32 or float64, got {str(dtype)[6:]}: for half precision, leave them "
                "as they are and compute under torch.autocast"
            )
        height, width = left.shape[2:]
        zoom = self.config.zoom
        if zoom == 1:
            yield from self._stages(left, right)
            return
        left, right = (resized(image, zoom) for image in (left, right))
        for estimate in self._stages(left, right):
            yield resize(estimate, (height, width), scale=width / left.shape[3])

    def _stages(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        height, width = left.shape[2:]
        # Padding at the right and the bottom moves no pixel, and the left-to-right scan meets it last.
        padding = (0, -width % self.config.stride, 0, -height % self.config.stride)
        left, right = (F.pad(image, padding, mode="replicate") if any(padding) else image for image in (left, right))
        for estimate in self._padded_stages(left, right):
            yield estimate[..., :height, :width]

    def _padded_stages(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        height, width = size = left.shape[2], left.shape[3]
        images = torch.cat([left, right])
        if self.config.enlargement > 1:
            images = resize(images, (height * self.config.enlargement, width * self.config.enlargement))
        skips = self.features.encode(images)
        finer = skips[-2]
        levels = self.features.decode(skips)
        coarsest = next(levels)
        estimate = resize(self.first_stage(coarsest, finer), size, scale=self.config.stride // self.first_stage.finer)
        yield estimate
        for stage, features in zip(self.residual_stages, levels, strict=True):
            h, w = features.shape[2:]
            scale = height // h
            update = stage(features, resize(estimate, (h, w), scale=1 / scale))
            estimate = resize(update, size, scale=scale, add=None if stage.replaces else estimate)
            yield estimate
        estimate = resize(estimate, (height // self.config.finest, width // self.config.finest))
        yield resize(self.refinement(left, right, estimate), size)


def normalize(images: Tensor) -> Tensor:
    """RGB uint8 [N, 3, H, W] -> the network's input."""
    # Channel by channel: a tensor of constants would have the host wait for a GPU.
    channels = zip(images.unbind(1), MEAN, STD, strict=True)
    return torch.stack([(channel - 255 * mean) / (255 * deviation) for channel, mean, deviation in channels], 1)


def resized(images: Tensor, scale: float) -> Tensor:
    """[N, C, H, W] by the factor `scale`: bilinear; where it shrinks, each pixel the mean of what it covers, as
    OpenCV's INTER_AREA, by which the predictor resizes arrays."""
    height, width = (max(1, round(scale * side)) for side in images.shape[2:])
    if scale >= 1:
        return F.interpolate(images, (height, width), mode="bilinear")
    return _shrunk(_shrunk(images, width).mT, height).mT.contiguous()


def _shrunk(images: Tensor, count: int) -> Tensor:
    """The last axis in `count` pixels that cover the same length, each the mean of what it covers."""
    size = images.shape[-1]
    edges = torch.arange(count + 1, dtype=torch.float64, device=images.device) * (size / count)
    first, begin, end = edges[:-1].long(), edges[:-1], edges[1:]
    total = images.new_zeros(())
    for pixel in (first + i for i in range(math.ceil(size / count) + 1)):  # all that one may touch
        covered = (torch.minimum(end, pixel + 1) - torch.maximum(begin, pixel)).clamp(min=0) * (count / size)
        total = total + images[..., pixel.clamp(max=size - 1)] * covered.to(images.dtype)
    return total
