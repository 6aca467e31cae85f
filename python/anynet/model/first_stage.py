"""Stage 1: the full disparity, from a cost volume at the coarsest features (section III-B of the paper)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anynet.model.config import AnyNetConfig
from anynet.model.cost_volume import DeployedCostVolume, Distribution, cost_network, group_cost_volume
from anynet.model.layers import PreActivation, affine_of, deploy_chain, run
from anynet_ext import soft_argmin

_ops = torch.ops.anynet


class FirstStage(nn.Module):
    """Cost volume, 3-D convolutions, soft-argmin."""

    def __init__(self, config: AnyNetConfig) -> None:
        super().__init__()
        c = config.first_stage
        self.groups, self.range = config.groups, c.range
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

    def __init__(self, stage: FirstStage) -> None:
        super().__init__()
        begin, *rest = stage.network
        assert isinstance(begin, PreActivation)
        self.first, last = stage.range
        self.volume = DeployedCostVolume(stage.groups, self.first, last, affine_of(begin.norm))
        self.layers = deploy_chain([begin, *rest], activated=True)
        self.fine_volume: DeployedCostVolume | None = None
        self.fine_costs: nn.Module | None = None
        if stage.fine_costs is not None:  # what it gives is added before the next layer's ReLU
            following = rest[0]
            assert isinstance(following, PreActivation)
            scale, shift = affine_of(following.norm)
            self.layers[0] = begin.deploy(None, (scale, shift), relu_out=False)
            affine = affine_of(stage.fine_costs.norm)
            self.fine_volume = DeployedCostVolume(stage.groups, 2 * self.first, 2 * last + 1, affine)
            self.fine_costs = stage.fine_costs.deploy(None, (scale, torch.zeros_like(shift)), relu_out=False)

    def forward(self, features: Tensor, finer: Tensor) -> tuple[Tensor, Distribution]:
        begin, *rest = self.layers
        x = begin(self.volume(features))
        if self.fine_costs is not None and self.fine_volume is not None:
            x.add_(self.fine_costs(self.fine_volume(finer))).relu_()
        cost = run(rest, x, features[:1])
        out: Tensor = _ops.soft_argmin.default(cost[:, 0], self.first)
        return out, Distribution(cost[:, 0], self.first)
