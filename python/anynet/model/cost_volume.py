"""Cost volumes of a pair's features, and the network that judges them."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

from anynet.model.chains import Hourglass
from anynet.model.layers import Affine, Deployed, PreActivation
from anynet_ext import cost_volume, warp

_ops = torch.ops.anynet


def group_cost_volume(features: Tensor, disparity: Tensor | None, first: int, last: int, groups: int) -> Tensor:
    """The group-wise cost volume [N, groups, D, h, w] of features [2N, C, h, w] of all left, then all right images.

    Of no groups, it is [N, 2C, D, h, w]: the left features and the right ones of each disparity.
    """
    if not groups:
        return _concatenated(features, disparity, first, last)
    _, c, *size = features.shape
    # The groups of a pair's channels go as so many pairs.
    left, right = features.reshape(2, -1, c // groups, *size)
    if disparity is not None:
        disparity = disparity.repeat_interleave(groups, 0)
    volume = cost_volume(left, right, disparity, first, last)
    return volume.view(-1, groups, *volume.shape[1:])


def _concatenated(features: Tensor, disparity: Tensor | None, first: int, last: int) -> Tensor:
    left, right = features.chunk(2)
    around = left.new_zeros(left[:, :1].shape) if disparity is None else disparity
    pairs = [torch.cat([left, warp(right, around + offset)], 1) for offset in range(first, last + 1)]
    return torch.stack(pairs, 2)


class DeployedCostVolume(Deployed):
    """The same of one pair, through the norm (an affine) and ReLU of the layer after it."""

    def __init__(self, groups: int, first: int, last: int, affine: Affine) -> None:
        super().__init__()
        self.groups, self.first, self.last = groups, first, last
        self.scale: Tensor
        self.shift: Tensor
        self.register_buffer("scale", affine[0])
        self.register_buffer("shift", affine[1])

    def forward(self, features: Tensor, disparity: Tensor | None = None) -> Tensor:
        if not self.groups:
            shape = (-1, 1, 1, 1)
            volume = _concatenated(features, disparity, self.first, self.last)
            return torch.addcmul(self.shift.view(shape), volume, self.scale.view(shape)).relu_()
        if self.groups == 1:
            left, right = features.chunk(2)
        else:  # the groups of a pair's channels go as so many pairs
            left, right = features.view(2, self.groups, -1, *features.shape[2:]).unbind()
            disparity = None if disparity is None else disparity.expand(self.groups, -1, -1, -1)
        out: Tensor = _ops.cost_volume_affine_relu.default(
            left, right, disparity, self.first, self.last, self.scale, self.shift
        )
        return out[None]


def cost_network(inputs: int, channels: int, layers: int, hourglass: int = 0, guide: int = 0) -> nn.Sequential:
    """Layers from a cost volume [N, inputs, D, H, W] to costs [N, 1, D, H, W]."""
    widths, middle = [inputs, *[channels] * (layers + 1), 1], 1 + (layers + 1) // 2
    network = nn.Sequential(
        *(
            PreActivation(*ends, dims=3, guide=guide if i in (1, middle) else 0)
            for i, ends in enumerate(pairwise(widths))
        )
    )
    begin_undecided(network)
    if hourglass:
        network.insert(middle, Hourglass(channels, 2 * channels, hourglass, guide))
    return network


@torch.no_grad()
def begin_undecided(network: nn.Sequential) -> None:
    """Small costs at first, so that no random one wins the softmax."""
    last = network[-1]
    assert isinstance(last, PreActivation)
    last.conv.weight.mul_(0.1)


class Distribution(NamedTuple):
    """What a deployed stage's softmax weighs: costs [1, D, h, w] of the values first, first + 1, ..., and offsets."""

    cost: Tensor
    first: int
    offsets: Tensor | None = None

    def deviation(self, step: int = 1) -> Tensor:
        """Standard deviation of every `step`th pixel and row, [ceil(h / step), ceil(w / step)], in pixels of the
        stage's features."""
        cost = self.cost[0, :, ::step, ::step]
        offsets = None if self.offsets is None else self.offsets[0, :, ::step, ::step]
        weight = (cost.amin(0) - cost).exp_()  # of the softmax, times a constant
        count = len(weight) - (0 if offsets is None else len(offsets))
        values = torch.arange(self.first, self.first + count, dtype=weight.dtype, device=weight.device)
        powers = torch.stack([torch.ones_like(values), values, values**2])
        total, mean, square = (powers @ weight[:count].flatten(1)).view(3, *weight.shape[1:])
        if offsets is not None:
            total = total + weight[count:].sum(0)
            mean = mean + (weight[count:] * offsets).sum(0)
            square = square + (weight[count:] * offsets**2).sum(0)
        mean = mean / total
        spread: Tensor = (square / total - mean**2).clamp_(min=0).sqrt_()
        return spread
