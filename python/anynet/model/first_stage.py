"""Stage 1: the full disparity, from a cost volume at the coarsest features (section III-B of the paper)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anynet.model.chains import DeployedUpsampleAdd, Hourglass, deploy_chain, run, upsample_add
from anynet.model.config import AnyNetConfig
from anynet.model.cost_volume import (
    DeployedCostVolume,
    Distribution,
    begin_undecided,
    cost_network,
    group_cost_volume,
)
from anynet.model.layers import PreActivation, affine_of
from anynet_ext import soft_argmin

_ops = torch.ops.anynet


def first_stage(config: AnyNetConfig) -> FirstStage | FlatFirstStage:
    """The first stage of this network."""
    return FlatFirstStage(config) if config.first_stage.dims == 2 else FirstStage(config)


class FirstStage(nn.Module):
    """Cost volume, 3-D convolutions, soft-argmin."""

    finer = 1  # times the features' resolution

    def __init__(self, config: AnyNetConfig) -> None:
        super().__init__()
        c = config.first_stage
        self.groups, self.range, self.guided = config.groups, c.range, c.excitation
        guide = config.features.widths[-1] if c.excitation else 0
        inputs = config.groups or 2 * config.features.widths[-1]
        self.network = cost_network(inputs, c.channels, c.layers, c.hourglass, guide)
        self.fine_costs: PreActivation | None = None
        if c.fine_costs:
            self.fine_costs = PreActivation(config.groups, c.channels, dims=3, stride=2)
            nn.init.zeros_(self.fine_costs.conv.weight)

    def forward(self, features: Tensor, finer: Tensor) -> Tensor:
        """The disparity [N, 1, h, w], in pixels of `features`.

        Args:
            features: [2N, C, h, w], of all left and then all right images.
            finer: the same of twice the resolution, for `fine_costs`.
        """
        begin, *rest = self.network
        first, last = self.range
        x = begin(group_cost_volume(features, None, first, last, self.groups))
        if self.fine_costs is not None:
            x = x + self.fine_costs(group_cost_volume(finer, None, 2 * first, 2 * last + 1, self.groups))
        cost = run(rest, x, features[: len(features) // 2])
        return soft_argmin(cost[:, 0], first)

    def deploy(self) -> DeployedFirstStage:
        return DeployedFirstStage(self)


class DeployedFirstStage(nn.Module):
    """The same of one pair, [2, C, h, w]."""

    finer = 1

    def __init__(self, stage: FirstStage) -> None:
        super().__init__()
        begin, *rest = stage.network
        assert isinstance(begin, PreActivation)
        self.first, last = stage.range
        self.guided = stage.guided
        self.volume = DeployedCostVolume(stage.groups, self.first, last, affine_of(begin.norm))
        self.fine_volume: DeployedCostVolume | None = None
        self.fine_costs: nn.Module | None = None
        if stage.fine_costs is None:
            self.layers = deploy_chain([begin, *rest], activated=True)
        else:  # what it gives is added before the next layer's ReLU
            following = rest[0]
            assert isinstance(following, PreActivation)
            scale, shift = affine_of(following.norm)
            first = begin.deploy(None, (scale, shift), relu_out=False)
            self.layers = nn.ModuleList([first, *deploy_chain(rest, activated=True)])
            affine = affine_of(stage.fine_costs.norm)
            self.fine_volume = DeployedCostVolume(stage.groups, 2 * self.first, 2 * last + 1, affine)
            self.fine_costs = stage.fine_costs.deploy(None, (scale, torch.zeros_like(shift)), relu_out=False)

    def forward(self, features: Tensor, finer: Tensor) -> tuple[Tensor, Distribution]:
        begin, *rest = self.layers
        x = begin(self.volume(features))
        if self.fine_costs is not None and self.fine_volume is not None:
            x.add_(self.fine_costs(self.fine_volume(finer))).relu_()
        cost = run(rest, x, features[:1] if self.guided else None)[0]
        out: Tensor = _ops.soft_argmin.default(cost, self.first)
        return out, Distribution(cost, self.first)


class FlatFirstStage(nn.Module):
    """Cost volumes of two resolutions, 2-D convolutions whose channels are the disparities, soft-argmin.

    Some thirty channels of two dimensions see as much as 16 of three for a fraction of the work, and so can look at
    features of twice the resolution (Guo et al., "LightStereo", arXiv 2406.19833, at 1/4 of it).
    """

    finer = 2  # times the features' resolution

    def __init__(self, config: AnyNetConfig) -> None:
        super().__init__()
        c = config.first_stage
        self.range = first, last = c.range
        coarse, fine = last - first + 1, 2 * (last - first + 1)
        deepest, finer = config.features.widths[-1], config.features.widths[-2]
        guide = deepest if c.excitation else 0
        self.begin = PreActivation(fine + finer, c.channels)
        self.down = PreActivation(c.channels, c.channels, stride=2)
        self.middle = nn.Sequential(
            PreActivation(c.channels + coarse, c.channels), PreActivation(c.channels, c.channels, guide=guide)
        )
        if c.hourglass > 1:
            self.middle.append(Hourglass(c.channels, c.channels, c.hourglass - 1, guide, dims=2))
        self.middle.append(PreActivation(c.channels, c.channels))
        self.end = nn.Sequential(*(PreActivation(c.channels, c.channels) for _ in range(c.layers)))
        self.end.append(PreActivation(c.channels, fine))
        begin_undecided(self.end)

    def forward(self, features: Tensor, finer: Tensor) -> Tensor:
        """The disparity [N, 1, 2h, 2w], in pixels of `finer`.

        Args:
            features: [2N, C, h, w], of all left and then all right images.
            finer: the same of twice the resolution.
        """
        first, last = self.range
        volume = group_cost_volume(finer, None, 2 * first, 2 * last + 1, 1)[:, 0]
        x = self.begin(torch.cat([volume, finer[: len(finer) // 2]], 1))
        coarse = torch.cat([self.down(x), group_cost_volume(features, None, first, last, 1)[:, 0]], 1)
        coarse = run(self.middle, coarse, features[: len(features) // 2])
        cost = self.end(upsample_add(x, coarse))
        return soft_argmin(cost, 2 * first)

    def deploy(self) -> DeployedFlatFirstStage:
        return DeployedFlatFirstStage(self)


class DeployedFlatFirstStage(nn.Module):
    """The same of one pair, [2, C, h, w]."""

    finer = 2

    def __init__(self, stage: FlatFirstStage) -> None:
        super().__init__()
        self.range = stage.range
        begin_norm = affine_of(stage.begin.norm)
        following = stage.end[0]
        assert isinstance(following, PreActivation)
        self.begin = stage.begin.deploy(begin_norm, None)
        self.down = stage.down.deploy(affine_of(stage.down.norm), None)
        self.middle = deploy_chain(list(stage.middle))
        self.end = deploy_chain(list(stage.end), activated=True)
        self.add = DeployedUpsampleAdd(affine_of(following.norm))

    def forward(self, features: Tensor, finer: Tensor) -> tuple[Tensor, Distribution]:
        first, last = self.range
        volume = _ops.cost_volume.default(finer[:1], finer[1:], None, 2 * first, 2 * last + 1)
        x = self.begin(torch.cat([volume, finer[:1]], 1))
        volume = _ops.cost_volume.default(features[:1], features[1:], None, first, last)
        coarse = run(self.middle, torch.cat([self.down(x), volume], 1), features[:1])
        cost = run(self.end, self.add(x, coarse))
        out: Tensor = _ops.soft_argmin.default(cost, 2 * first)
        return out, Distribution(cost, 2 * first)
