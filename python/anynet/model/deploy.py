"""The network as it runs in deployment: bytes in, batch norms folded, and nothing computed that nobody asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.model.anynet import AnyNet
from anynet.model.chains import DeployedChain
from anynet.model.cost_volume import Distribution
from anynet.model.layers import DeployedConvolution

_ops = torch.ops.anynet


@dataclass(frozen=True)
class StageResult:
    """What a stage has found, still small; calling it gives the disparity [H, W].

    Attributes:
        maps, gains, scales: the disparity is the sum of the maps times their gains, in pixels of the images; and pixels
            of the images per pixel of each map.
        size: H, W.
        spread: of a stage that has one, its distribution, and pixels of the images per pixel of it.
        before: the stage before.
    """

    maps: list[Tensor]
    gains: list[float]
    scales: list[int]
    size: Sequence[int]
    spread: tuple[Distribution, int] | None
    before: StageResult | None

    def __call__(self, out: Tensor | None = None) -> Tensor:
        """Written to `out`, if it is given."""
        return sum_at(self.maps, self.scales, self.size, self.gains, out=out)

    def at(self, scale: int, size: Sequence[int]) -> Tensor:
        """The disparity, in pixels of the images, at a resolution of one pixel per `scale` of theirs."""
        maps = [m if s >= scale else block_means(m, scale // s) for m, s in zip(self.maps, self.scales, strict=True)]
        return sum_at(maps, [max(1, s // scale) for s in self.scales], size, self.gains)


class DeployedAnyNet(nn.Module):
    """An AnyNet with its weights frozen, for one pair at a time; it strings the parts' deployed forms together.

    The estimates are never added up at full size before somebody wants to see one. Each stage's result stays small, and
    since pixels are areas, what the next stage needs, the sum enlarged to full size and reduced to the features' size,
    is exactly the small results enlarged to the features' size, or blurred a little if they have it already. (A stage
    that replaces the estimate leaves a sum of one term.)

    `config.zoom` is the caller's: the images are taken as they are.

    Args:
        model: in eval mode.
        precision: for a GPU: in which type its wider convolutions compute, by cuDNN. Cost volumes, disparities and all
            that lies between layers are float32. None: all is computed by our own operators, as on the CPU.
    """

    @torch.no_grad()
    def __init__(self, model: AnyNet, precision: torch.dtype | None = None) -> None:
        super().__init__()
        self.config = config = model.config
        self.features = model.features.deploy(config.enlargement, config.stride)
        self.first_stage = model.first_stage.deploy()
        self.residual_stages = nn.ModuleList(stage.deploy() for stage in model.residual_stages)  # type: ignore[operator]
        self.refinement = model.refinement.deploy()
        self.requires_grad_(False).eval()
        if precision is not None:
            for part in self.modules():
                if isinstance(part, (DeployedConvolution, DeployedChain)):
                    part.for_gpu(precision)

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
        maps, scales = [disparity[0, 0]], [scale]
        gains = [float(scale)]
        result = StageResult(maps, gains, scales, size, (distribution, scale), None)
        yield result
        for i, (stage, features) in enumerate(zip(self.residual_stages, levels, strict=True), 1):
            scale = coarsest >> i
            disparity = _reduced(maps, [g / scale for g in gains], scales, scale, features.shape[2:])
            update, distribution = stage(features, disparity[None, None])
            found = update[0, 0]
            if stage.replaces:
                maps, gains, scales = [], [], []
            elif scales[-1] == scale:  # a finer first stage's: one map per scale, as `_reduced` smooths only one
                found = found + maps[-1]
                maps, gains, scales = maps[:-1], gains[:-1], scales[:-1]
            maps, gains, scales = [*maps, found], [*gains, scale], [*scales, scale]
            result = StageResult(maps, gains, scales, size, (distribution, scale), result)
            yield result
        disparity = _reduced(maps, gains, scales, scale, maps[-1].shape)
        refined = self.refinement(left, right, disparity[None, None])[0, 0]
        yield StageResult([refined], [1.0], [scale * disparity.shape[1] // refined.shape[1]], size, None, result)


def sum_at(
    maps: list[Tensor],
    ratios: list[int],
    size: Sequence[int],
    gains: Sequence[float] = (),
    side: float = 0.0,
    out: Tensor | None = None,
) -> Tensor:
    """[h, w]: the sum of the maps times their gains, each enlarged by its ratio; see `anynet_ext.upsample_sum`."""
    if out is None:
        result: Tensor = _ops.upsample_sum.default(maps, ratios, list(gains), side, *size)
        return result
    _ops.upsample_sum.out(maps, ratios, list(gains), side, out=out)
    return out


def block_means(x: Tensor, side: int) -> Tensor:
    """[..., ceil(h / side), ceil(w / side)], of [..., h, w] and a power of two; several times as fast as a pooling."""
    while side > 1:
        side //= 2
        height, width = x.shape[-2:]
        if height % 2 or width % 2:
            x = F.pad(x[None], (0, width % 2, 0, height % 2), mode="replicate")[0]
        rows = x[..., 0::2, :] + x[..., 1::2, :]
        x = (rows[..., 0::2] + rows[..., 1::2]).mul_(0.25)
    return x


def _reduced(maps: list[Tensor], gains: list[float], scales: list[int], scale: int, size: Sequence[int]) -> Tensor:
    """[h, w]: the sum of the maps times their gains, enlarged to full size and reduced to one pixel per `scale`.

    That smooths a map of this very scale: 1/8, 3/4, 1/8 along both axes if it is 2, 1/16, 7/8, 1/16 if it is 4.
    """
    side = 0.0 if scales[-1] > scale else 1 / (4 * scale)
    return sum_at(maps, [s // scale for s in scales], size, gains, side)
