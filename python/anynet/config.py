"""What an AnyNet is made of."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from anynet.errors import AnyNetError


@dataclass(frozen=True, kw_only=True)
class AnyNetConfig:
    """The shape of the network; the defaults are the paper's (Table I), with 43,269 parameters.

    The finest features lie at 1/4 of the input's resolution, and each of `blocks` further blocks halves it. There is
    one stage per resolution, coarsest first, and a last one that refines: `blocks + 2` in all.

    Args:
        input_scale: 1, or 2: the images are enlarged to twice their size first, which makes everything finer for four
            times the work. Sizes and resolutions below are those of the enlarged images; estimates are not enlarged.
        channels: feature channels at full and half resolution; doubled with each halving after that.
        blocks: U-Net blocks below 1/4 resolution.
        layers: convolutions per U-Net block.
        groups: the features' channels are compared in so many groups, each a channel of the cost volume; the paper: 1.
        cost_channels: channels of the disparity network, per stage.
        cost_layers: its convolutions between the first and the last one.
        hourglass: halvings of the first stage's volume in the middle of its disparity network, which see wide
            surfaces as a whole; the paper: 0.
        finer_costs: the first stage also compares features of twice its resolution, those of the U-Net's way down, by a
            cost volume that is halved into its own. So it can tell things thinner than its pixels. The paper: False.
        guided: the left image's features say, pixel by pixel, which channels count inside the first stage's disparity
            network; the paper: False.
        ranges: the disparities (first stage) and residuals (later ones) to test, per stage: first and last, in pixels
            of that stage's resolution.
        neighbours: the residual stages also test the nearest and the farthest disparity at most so many of their pixels
            away, in rows and columns, and judge all by a two-dimensional network of three convolutions (`Update`). The
            paper: 0, residuals alone, by a network like the first stage's.
        spn_channels: channels of the spatial propagation.
        spn_directions: its scans: 0 left to right, 1 right to left, 2 top to bottom, 3 bottom to top.
        spn_combine: how the scans' results become one.
        spn_fill: what the estimate hides from the right camera, behind something nearer or beyond the border, takes
            the disparity of the background beside it before the propagation; the paper: False.
        spn_mismatch: the propagation is steered not by the left image alone, but also by the disparity and by how the
            right image, warped by it, differs. So it can tell what the right camera does not see. The paper: False.
        spn_upsampling: the result is enlarged to twice the finest features' resolution not bilinearly, but by weights
            learnt from the left image, which the propagation's guidance then sees at that resolution. The paper: False.
        reversed_residuals: the residual stages test disparity `d - s` where they count it as `d + s`, as the authors'
            released code and weights do.
    """

    input_scale: int = 1
    channels: int = 1
    blocks: int = 2
    layers: int = 2
    groups: int = 1
    cost_channels: tuple[int, ...] = (16, 4, 4)
    cost_layers: int = 4
    hourglass: int = 0
    finer_costs: bool = False
    guided: bool = False
    ranges: tuple[tuple[int, int], ...] = ((0, 11), (-2, 2), (-2, 2))
    neighbours: int = 0
    spn_channels: int = 8
    spn_directions: tuple[int, ...] = (0,)
    spn_combine: Literal["max", "mean"] = "max"
    spn_fill: bool = False
    spn_mismatch: bool = False
    spn_upsampling: bool = False
    reversed_residuals: bool = False

    def __post_init__(self) -> None:
        for name in ("channels", "blocks", "layers", "spn_channels"):
            if getattr(self, name) < 1:
                raise AnyNetError(f"AnyNetConfig: expected {name} >= 1, got {getattr(self, name)}")
        if self.groups < 1 or 2 * self.channels % self.groups:
            raise AnyNetError(
                f"AnyNetConfig: expected groups to divide the finest features' {2 * self.channels} channels, "
                f"got {self.groups}"
            )
        if self.input_scale not in (1, 2):
            raise AnyNetError(f"AnyNetConfig: expected input_scale 1 or 2, got {self.input_scale}")
        for name in ("cost_layers", "hourglass", "neighbours"):
            if getattr(self, name) < 0:
                raise AnyNetError(f"AnyNetConfig: expected {name} >= 0, got {getattr(self, name)}")
        for name in ("cost_channels", "ranges"):
            if len(getattr(self, name)) != self.blocks + 1:
                raise AnyNetError(
                    f"AnyNetConfig: expected {name} for each of {self.blocks + 1} stages (blocks + 1), "
                    f"got {getattr(self, name)}"
                )
        if self.neighbours and self.reversed_residuals:
            raise AnyNetError("AnyNetConfig: expected no neighbours with reversed_residuals")
        if any(first > last for first, last in self.ranges):
            raise AnyNetError(f"AnyNetConfig: expected ranges (first, last) with first <= last, got {self.ranges}")
        directions = self.spn_directions
        if not directions or len(set(directions)) < len(directions) or not set(directions) <= {0, 1, 2, 3}:
            raise AnyNetError(f"AnyNetConfig: expected spn_directions of distinct 0, 1, 2, 3, got {directions}")
        if self.spn_combine not in ("max", "mean"):
            raise AnyNetError(f"AnyNetConfig: expected spn_combine 'max' or 'mean', got {self.spn_combine!r}")

    def with_input_scale(self, input_scale: int) -> AnyNetConfig:
        """For the same weights, other enlarging: the first stage reaches as far in the input's pixels as before."""
        return replace(self.reaching(input_scale / self.input_scale), input_scale=input_scale)

    def reaching(self, growth: float) -> AnyNetConfig:
        """The same with a first stage that tests `growth` times the range of disparities."""
        (first, last), *residuals = self.ranges
        reach = math.floor(first * growth), math.ceil((last + 1) * growth) - 1
        return replace(self, ranges=(reach, *residuals))

    @property
    def feature_channels(self) -> list[int]:
        """Channels of the features at 1/4, 1/8, ... of the resolution."""
        return [self.channels * 2 ** (i + 1) for i in range(self.blocks + 1)]

    @property
    def stages(self) -> int:
        """The number of estimates: one per resolution and the refined one."""
        return self.blocks + 2

    @property
    def stride(self) -> int:
        """Input pixels per pixel of the coarsest features; the network pads images to multiples of it."""
        return (4 << self.blocks) // self.input_scale

    @property
    def finest(self) -> int:
        """Input pixels per pixel of the finest features."""
        return 4 // self.input_scale
