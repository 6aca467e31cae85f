"""Stages 2 and 3: warp by the estimate, and look for what is missing (section III-C of the paper)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anynet.model.chains import chain, deploy_chain, run
from anynet.model.config import AnyNetConfig
from anynet.model.cost_volume import DeployedCostVolume, Distribution, begin_undecided, cost_network, group_cost_volume
from anynet.model.layers import DeployedConvolution, PreActivation, affine_of
from anynet_ext import cost_volume, reference, soft_argmin

_ops = torch.ops.anynet


def residual_stage(config: AnyNetConfig, index: int) -> ResidualStage | CandidateStage | FullRangeStage:
    """The residual stage number `index`, from 0."""
    if config.residual_stages.full_range:
        return FullRangeStage(config, index)
    return CandidateStage(config, index) if config.residual_stages.candidate_radius else ResidualStage(config, index)


class ResidualStage(nn.Module):
    """The residual by soft-argmin over a cost volume around the estimate: what is to be added to it."""

    replaces = False

    def __init__(self, config: AnyNetConfig, index: int) -> None:
        super().__init__()
        c = config.residual_stages
        self.groups, self.range, self.reverse = config.groups, c.ranges[index], c.reverse
        inputs = config.groups or 2 * config.features.widths[-2 - index]
        self.network = cost_network(inputs, c.channels[index], c.layers)

    def forward(self, features: Tensor, disparity: Tensor) -> Tensor:
        """The residual [N, 1, h, w] of the disparity, both in pixels of the features [2N, C, h, w]."""
        first, last = self.range
        if self.reverse:
            volume = group_cost_volume(features, disparity, -last, -first, self.groups).flip(2)
        else:
            volume = group_cost_volume(features, disparity, first, last, self.groups)
        cost: Tensor = self.network(volume)
        return soft_argmin(cost[:, 0], first)

    def deploy(self) -> DeployedResidualStage:
        return DeployedResidualStage(self)


class DeployedResidualStage(nn.Module):
    """The same of one pair. The reverse search is the plain one mirrored: range, kernels, and the result's sign."""

    replaces = False

    def __init__(self, stage: ResidualStage) -> None:
        super().__init__()
        first, last = stage.range
        self.sign = -1 if stage.reverse else 1
        self.first, last = (-last, -first) if stage.reverse else (first, last)
        begin = stage.network[0]
        assert isinstance(begin, PreActivation)
        self.volume = DeployedCostVolume(stage.groups, self.first, last, affine_of(begin.norm))
        self.layers = deploy_chain(list(stage.network), activated=True)
        if stage.reverse:
            for part in self.layers.modules():
                if isinstance(part, DeployedConvolution):
                    part.weight = torch.flip(part.weight, (2,))

    def forward(self, features: Tensor, disparity: Tensor) -> tuple[Tensor, Distribution]:
        cost = run(self.layers, self.volume(features, disparity))[0]
        out: Tensor = _ops.soft_argmin.default(cost, self.first)
        return out.neg_() if self.sign < 0 else out, Distribution(cost, self.first)


class FullRangeStage(nn.Module):
    """The full disparity again, at finer features: what stages would be without residuals (section IV-C, Fig. 7)."""

    replaces = True

    def __init__(self, config: AnyNetConfig, index: int) -> None:
        super().__init__()
        c = config.residual_stages
        finer = 2 ** (index + 1)
        first, last = config.first_stage.range
        self.groups, self.range = config.groups, (finer * first, finer * (last + 1) - 1)
        inputs = config.groups or 2 * config.features.widths[-2 - index]
        self.network = cost_network(inputs, c.channels[index], c.layers)

    def forward(self, features: Tensor, disparity: Tensor) -> Tensor:
        """The disparity [N, 1, h, w], in pixels of the features [2N, C, h, w]; the one known before is not used."""
        cost: Tensor = self.network(group_cost_volume(features, None, *self.range, self.groups))
        return soft_argmin(cost[:, 0], self.range[0])

    def deploy(self) -> DeployedFullRangeStage:
        return DeployedFullRangeStage(self)


class DeployedFullRangeStage(nn.Module):
    """The same of one pair."""

    replaces = True

    def __init__(self, stage: FullRangeStage) -> None:
        super().__init__()
        self.first, last = stage.range
        begin = stage.network[0]
        assert isinstance(begin, PreActivation)
        self.volume = DeployedCostVolume(stage.groups, self.first, last, affine_of(begin.norm))
        self.layers = deploy_chain(list(stage.network), activated=True)

    def forward(self, features: Tensor, disparity: Tensor) -> tuple[Tensor, Distribution]:
        cost = run(self.layers, self.volume(features))[0]
        out: Tensor = _ops.soft_argmin.default(cost, self.first)
        return out, Distribution(cost, self.first)


class CandidateStage(nn.Module):
    """The expected disparity over candidates: around the estimate, and the nearest and farthest of its neighborhood.

    Enlarged estimates blur depth edges and lose what is thinner than a coarse pixel. A neighbor may still know its
    disparity, however far that is from the estimate, and its cost tells whether it fits: the propagation of PatchMatch
    stereo (Bleyer et al., BMVC 2011). In two dimensions, the candidates being so many channels.
    """

    replaces = True

    def __init__(self, config: AnyNetConfig, index: int) -> None:
        super().__init__()
        c = config.residual_stages
        self.groups, self.range, self.radius = config.groups, c.ranges[index], c.candidate_radius
        width = config.features.widths[-2 - index]
        candidates = self.range[1] - self.range[0] + 3
        channels = c.channels[index]
        self.network = chain([config.groups * candidates + width + 2, channels, channels, candidates])
        begin_undecided(self.network)

    def forward(self, features: Tensor, disparity: Tensor) -> Tensor:
        """The new disparity [N, 1, h, w]; both in pixels of the features [2N, C, h, w]."""
        first, last = self.range
        x = reference.candidate_costs(features, disparity, self.groups, first, last, self.radius, volume=cost_volume)
        cost = self.network(x)
        return reference.expected_disparity(cost, disparity, x[:, -2:], first)

    def deploy(self) -> DeployedCandidateStage:
        return DeployedCandidateStage(self)


class DeployedCandidateStage(nn.Module):
    """The same of one pair."""

    replaces = True

    def __init__(self, stage: CandidateStage) -> None:
        super().__init__()
        self.groups, self.range, self.radius = stage.groups, stage.range, stage.radius
        self.layers = deploy_chain(list(stage.network))

    def forward(self, features: Tensor, disparity: Tensor) -> tuple[Tensor, Distribution]:
        x = _ops.candidate_costs.default(features, disparity, self.groups, *self.range, self.radius)
        cost = run(self.layers, x)
        out: Tensor = _ops.expected_disparity.default(cost, disparity, x[:, -2:], self.range[0])
        return out, Distribution(cost, self.range[0], x[:, -2:])
