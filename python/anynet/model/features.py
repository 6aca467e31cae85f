"""Features of both images, from coarse to fine (Fig. 2 of the paper)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.model.chains import chain, deploy_chain, run
from anynet.model.config import MEAN, STD, FeaturesConfig
from anynet.model.layers import Convolution, PreActivation, affine_of
from anynet_ext import resize

_ops = torch.ops.anynet


class UNet(nn.Module):
    """The way down once, and the way up one level at a time; with `down_to`, the way down to that level alone."""

    def __init__(self, config: FeaturesConfig, *, down_to: int | None = None) -> None:
        super().__init__()
        c, widths = config.channels, config.widths if down_to is None else config.widths[: down_to + 1]
        self.first = Convolution(3, c, bias=True)
        self.halve = PreActivation(c, c, stride=2)
        self.down = nn.ModuleList(
            chain([i] + [o] * config.layers) for i, o in zip([c, *widths[:-1]], widths, strict=True)
        )
        self.up = nn.ModuleList(  # in order of use, coarse to fine
            chain([widths[i] + widths[i + 1]] + [widths[i]] * config.layers)
            for i in reversed(range(config.blocks if down_to is None else 0))
        )

    def encode(self, image: Tensor) -> list[Tensor]:
        """The way down: [N, C, h, w] at 1/4, 1/8, ..."""
        x = self.halve(self.first(image))
        skips = []
        for block in self.down:
            x = block(F.max_pool2d(x, 2))
            skips.append(x)
        return skips

    def decode(self, skips: list[Tensor]) -> Iterator[Tensor]:
        """The way up: features, coarsest first; no level is computed before it is asked for. Takes `skips` apart."""
        x = skips.pop()
        yield x
        for block in self.up:
            skip = skips.pop()
            x = resize(x, (skip.shape[2], skip.shape[3]), align_corners=True)
            x = block(torch.cat([skip, x], 1))
            yield x

    def deploy(self, enlargement: int, stride: int) -> DeployedUNet:
        """For images that are enlarged so many times, and then padded to multiples of `stride` pixels."""
        return DeployedUNet(self, enlargement, enlargement * stride)


class SeparateFeatures(nn.Module):
    """A network per stage in the U-Net's stead (section IV-C of the paper).

    Each is the U-Net's way down as far as the stage's resolution and, in place of the way up, as many layers there.
    """

    def __init__(self, config: FeaturesConfig) -> None:
        super().__init__()
        widths = config.widths
        levels = range(config.blocks, -1, -1)  # coarse to fine
        self.encoders = nn.ModuleList(UNet(config, down_to=level) for level in levels)
        self.blocks = nn.ModuleList(chain([widths[i]] + [widths[i]] * config.layers) for i in levels[1:])

    def encode(self, image: Tensor) -> list[Tensor]:
        """The image, and the coarsest network's way down."""
        coarsest = self.encoders[0]
        assert isinstance(coarsest, UNet)
        return [image, *coarsest.encode(image)]

    def decode(self, skips: list[Tensor]) -> Iterator[Tensor]:
        """As `UNet.decode`: each network runs when its features are asked for."""
        image = skips[0]
        yield skips[-1]
        for encoder, block in zip(self.encoders[1:], self.blocks, strict=True):
            yield block(encoder.encode(image)[-1])  # type: ignore[operator]

    def deploy(self, enlargement: int, stride: int) -> DeployedSeparateFeatures:
        """As `UNet.deploy`."""
        return DeployedSeparateFeatures(self, enlargement, stride)


class DeployedSeparateFeatures(nn.Module):
    """The same on images in bytes."""

    def __init__(self, features: SeparateFeatures, enlargement: int, stride: int) -> None:
        super().__init__()
        self.encoders = nn.ModuleList(e.deploy(enlargement, stride) for e in features.encoders)  # type: ignore[operator]
        self.blocks = nn.ModuleList(deploy_chain(list(block)) for block in features.blocks)  # type: ignore[call-overload]

    def encode(self, left: Tensor, right: Tensor) -> list[Tensor]:
        coarsest = self.encoders[0]
        assert isinstance(coarsest, DeployedUNet)
        return [left, right, *coarsest.encode(left, right)]

    def decode(self, skips: list[Tensor]) -> Iterator[Tensor]:
        left, right = skips[:2]
        yield skips[-1]
        for encoder, block in zip(self.encoders[1:], self.blocks, strict=True):
            yield run(block, encoder.encode(left, right)[-1])  # type: ignore[operator,arg-type]


class DeployedUNet(nn.Module):
    """The same on images in bytes."""

    def __init__(self, unet: UNet, enlargement: int, multiple: int) -> None:
        super().__init__()
        self.enlargement, self.multiple = enlargement, multiple
        std = 255 * torch.tensor(STD, dtype=torch.float32, device=unet.first.weight.device)
        norm_scale, norm_shift = affine_of(unet.halve.norm)
        first_weight, first_bias = unet.first.weight.detach(), unet.first.bias
        assert first_bias is not None
        self.register_buffer("mean", 255 * torch.tensor(MEAN, dtype=torch.float32, device=std.device))
        weight = first_weight * norm_scale[:, None, None, None] / std[:, None, None]
        self.register_buffer("first_weight", weight.contiguous())
        self.register_buffer("first_bias", first_bias.detach() * norm_scale + norm_shift)
        self.register_buffer("second_weight", unet.halve.conv.weight.detach())
        self.down, self.up = _deployed_blocks(unet.down), _deployed_blocks(unet.up)
        for part, blocks in (("down", unet.down), ("up", unet.up)):
            for i, block in enumerate(blocks):
                scale, shift = affine_of(block[0].norm)  # type: ignore[index]
                self.register_buffer(f"{part}_scale_{i}", scale)
                self.register_buffer(f"{part}_shift_{i}", shift)

    def _affine(self, part: str, i: int) -> tuple[Tensor, Tensor]:
        own: dict[str, Any] = self._buffers
        return own[f"{part}_scale_{i}"], own[f"{part}_shift_{i}"]

    def encode(self, left: Tensor, right: Tensor) -> list[Tensor]:
        """Of uint8 RGB [H, W, 3]: [2, C, h, w] of the left image and the right one, finest first."""
        x = _ops.stem.default(
            left,
            right,
            self.mean,
            self.first_weight,
            self.first_bias,
            self.second_weight,
            *self._affine("down", 0),
            self.enlargement,
            self.multiple,
        )
        skips: list[Tensor] = []
        for i, layers in enumerate(self.down):
            x = run(layers, _ops.max_pool.default(x, *self._affine("down", i)) if i else x)  # type: ignore[arg-type]
            skips.append(x)
        return skips

    def decode(self, skips: list[Tensor]) -> Iterator[Tensor]:
        """As `UNet.decode`."""
        x = skips.pop()
        yield x
        for i, layers in enumerate(self.up):
            x = run(layers, _ops.upsample_concat.default(skips.pop(), x, *self._affine("up", i)))  # type: ignore[arg-type]
            yield x


def _deployed_blocks(blocks: nn.ModuleList) -> nn.ModuleList:
    return nn.ModuleList(deploy_chain(list(block), activated=True) for block in blocks)  # type: ignore[call-overload]
