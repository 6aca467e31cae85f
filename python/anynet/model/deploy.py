"""The network as it runs in deployment: bytes in, batch norms folded, and nothing computed that nobody asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import torch
from torch import Tensor, nn

from anynet.model.anynet import AnyNet
from anynet.model.cost_volume import Distribution

_ops = torch.ops.anynet


@dataclass(frozen=True)
class StageResult:
    """What a stage has found, still small; calling it gives the disparity [H, W].

    Attributes:
        maps, scales: the disparity is their sum, in pixels of the images; and pixels of the images per pixel of each.
        size: H, W.
        spread: of a stage that has one, its distribution, and pixels of the images per pixel of it.
        before: the stage before.
    """

    maps: list[Tensor]
    scales: list[int]
    size: Sequence[int]
    spread: tuple[Distribution, int] | None
    before: StageResult | None

    def __call__(self) -> Tensor:
        return self.at(1, self.size)

    def at(self, scale: int, size: Sequence[int]) -> Tensor:
        """The disparity, in pixels of the images, at a resolution of one pixel per `scale` of theirs."""
        return sum_at(self.maps, [s // scale for s in self.scales], size)


class DeployedAnyNet(nn.Module):
    """An AnyNet with its weights frozen, for one pair at a time; it strings the parts' deployed forms together.

    The estimates are never added up at full size before somebody wants to see one. Each stage's result stays small, and
    since pixels are areas, what the next stage needs, the sum enlarged to full size and reduced to the features' size,
    is exactly the small results enlarged to the features' size, or blurred a little if they have it already. (A stage
    that replaces the estimate leaves a sum of one term.)

    `config.zoom` is the caller's: the images are taken as they are.
    """

    @torch.no_grad()
    def __init__(self, model: AnyNet) -> None:
        super().__init__()
        self.config = config = model.config
        self.features = model.features.deploy(config.enlargement, config.stride)
        self.first_stage = model.first_stage.deploy()
        self.residual_stages = nn.ModuleList(stage.deploy() for stage in model.residual_stages)  # type: ignore[operator]
        self.refinement = model.refinement.deploy()
        self.requires_grad_(False).eval()

    def forward(self, left: Tensor, right: Tensor, stages: int | None = None) -> list[Tensor]:
        """The first `stages` disparity maps (default: all), [H, W] each, of uint8 RGB images [H, W, 3]."""
        return [enlarge() for enlarge in islice(self.stages(left, right), stages)]

    def stages(self, left: Tensor, right: Tensor) -> Iterator[StageResult]:
        """One result per stage, each giving that stage's full-size disparity [H, W] when called.

        Iterating computes a stage at low resolution; only calling the result enlarges it.

        Args:
            left, right: uint8 RGB, [H, W, 3], contiguous.
        """
        size = left.shape[:2]
        skips = self.features.encode(left, right)
        finer = skips[-2]
        levels = self.features.decode(skips)
        coarsest = self.config.stride
        scale = coarsest // self.first_stage.finer
        disparity, distribution = self.first_stage(next(levels), finer)
        maps: list[Tensor] = [disparity[0, 0].mul_(scale)]  # in pixels of the images
        scales: list[int] = [scale]  # pixels of the images per pixel of the map
        result = StageResult(maps, scales, size, (distribution, scale), None)
        yield result
        for i, (stage, features) in enumerate(zip(self.residual_stages, levels, strict=True), 1):
            scale = coarsest >> i
            disparity = _reduced(maps, scales, scale, features.shape[2:], 1 / scale)
            update, distribution = stage(features, disparity[None, None])
            update = update[0, 0].mul_(scale)
            maps, scales = ([update], [scale]) if stage.replaces else ([*maps, update], [*scales, scale])
            result = StageResult(maps, scales, size, (distribution, scale), result)
            yield result
        disparity = _reduced(maps, scales, scale, maps[-1].shape)
        refined = self.refinement(left, right, disparity[None, None])[0, 0]
        yield StageResult([refined], [scale * disparity.shape[1] // refined.shape[1]], size, None, result)


def sum_at(maps: list[Tensor], ratios: list[int], size: Sequence[int], gain: float = 1.0) -> Tensor:
    """[h, w]: the sum of the maps, each enlarged by its ratio."""
    out: Tensor = _ops.upsample_sum.default(maps, ratios, gain, *size)
    return out


def _reduced(maps: list[Tensor], scales: list[int], scale: int, size: Sequence[int], gain: float = 1.0) -> Tensor:
    """[h, w]: the sum of the maps, each enlarged to full size and reduced to one pixel per `scale`; times `gain`."""
    if scales[-1] > scale:
        return sum_at(maps, [s // scale for s in scales], size, gain)
    disparity = _blur(gain * maps[-1], scale)
    if len(maps) > 1:
        disparity += sum_at(maps[:-1], [s // scale for s in scales[:-1]], size, gain)
    return disparity


def _blur(x: Tensor, factor: int) -> Tensor:
    """Enlarged 2 or more times and reduced again: 1/8, 3/4, 1/8 or 1/16, 7/8, 1/16 and so on along both axes; the
    border goes on."""
    side = 1 / (4 * factor)
    for d in (0, 1):
        n = x.shape[d]
        before = torch.cat([x.narrow(d, 0, 1), x.narrow(d, 0, n - 1)], d)
        after = torch.cat([x.narrow(d, 1, n - 1), x.narrow(d, n - 1, 1)], d)
        x = (1 - 2 * side) * x + side * (before + after)
    return x
