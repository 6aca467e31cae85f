"""PSMNet (Chang and Chen, "Pyramid Stereo Matching Network", CVPR 2018, arXiv 1803.08669).

Layer by layer after the paper's Table 1, whose names are given below; 5,224,768 parameters with the stacked hourglass.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.baselines.baseline import Baseline
from anynet.baselines.layers import Layer, ResidualBlock, concatenation_volume, relu, trilinear
from anynet_ext import resize, soft_argmin


class PyramidFeatures(nn.Module):
    """Features [N, 32, H/4, W/4] of an image [N, 3, H, W], with their surroundings in four sizes (section 3.2).

    Table 1, "CNN" and "SPP module". Source of each part:
        stem: conv0_1 to conv0_3, 32 channels, the first of stride 2.
        blocks: conv1_x (3 blocks of 32), conv2_x (16 of 64, the first of stride 2), conv3_x (3 of 128, dilation 2),
            conv4_x (3 of 128, dilation 4; the authors' best KITTI network has half the dilations, Table 2). A block
            ends without an activation, as in the authors' code.
        branches: branch_1 to branch_4, means of 64, 32, 16 and 8 squared, then 1x1 convolutions to 32 channels.
        fusion: concat[conv2_16, conv4_3, branch_1 to 4], 320 channels, then 3x3 to 128 and 1x1 to 32.
    """

    POOLS = (64, 32, 16, 8)

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(*(_layer2d(i, 32, stride=s) for i, s in ((3, 2), (32, 1), (32, 1))))
        self.at_half = _blocks(32, 32, 3)
        self.at_quarter = _blocks(32, 64, 16, stride=2)
        self.context = nn.Sequential(*_blocks(64, 128, 3, dilation=2), *_blocks(128, 128, 3, dilation=4))
        self.branches = nn.ModuleList(Layer(128, 32, kernel=1, norm=True, activation=relu) for _ in self.POOLS)
        self.fusion = nn.Sequential(_layer2d(320, 128), Layer(128, 32, kernel=1, bias=False))

    def forward(self, image: Tensor) -> Tensor:
        raw = self.at_quarter(self.at_half(self.stem(image)))
        context = self.context(raw)
        height, width = context.shape[2:]
        around = []
        for pool, branch in zip(self.POOLS, self.branches, strict=True):
            means = F.avg_pool2d(context, (min(pool, height), min(pool, width)))  # small images have less around them
            around.append(resize(branch(means), (height, width)))
        out: Tensor = self.fusion(torch.cat([raw, context, *around], 1))
        return out


def _layer2d(inputs: int, outputs: int, stride: int = 1) -> Layer:
    return Layer(inputs, outputs, stride=stride, norm=True, activation=relu)


def _blocks(inputs: int, outputs: int, count: int, *, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    return nn.Sequential(
        *(
            ResidualBlock(
                outputs if i else inputs, outputs, activation=relu, stride=1 if i else stride, dilation=dilation
            )
            for i in range(count)
        )
    )


def _layer3d(inputs: int, outputs: int, *, stride: int = 1, activate: bool = True) -> Layer:
    return Layer(inputs, outputs, dims=3, stride=stride, norm=True, activation=relu if activate else None)


def _enlarging(inputs: int, outputs: int, *, activate: bool) -> Layer:
    return Layer(inputs, outputs, dims=3, stride=2, transposed=True, norm=True, activation=relu if activate else None)


class Head(nn.Module):
    """From a volume [N, 32, D/4, H/4, W/4] to its costs [N, D/4, H/4, W/4] (Table 1, "output" rows, 3x3x3)."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(_layer3d(32, 32), Layer(32, 1, dims=3, bias=False))

    def forward(self, volume: Tensor) -> Tensor:
        out: Tensor = self.layers(volume)[:, 0]
        return out


class _PSMNet(Baseline):
    """What both have: features, the volume and its first layers (Table 1: 3Dconv0, 3Dconv1 or 3Dstack1's input)."""

    stride = 16  # the hourglass halves the quarter size twice

    def __init__(self, max_disparity: int = 192) -> None:
        super().__init__(max_disparity)
        self.features = PyramidFeatures()
        self.begin = nn.Sequential(_layer3d(64, 32), _layer3d(32, 32))
        self.begin_residual = nn.Sequential(_layer3d(32, 32), _layer3d(32, 32, activate=False))

    def volume(self, left: Tensor, right: Tensor) -> Tensor:
        """[N, 32, D/4, H/4, W/4]; section 3.3: left features concatenated with the right ones of each disparity."""
        left, right = self.features(torch.cat([left, right])).chunk(2)
        x: Tensor = self.begin(concatenation_volume(left, right, 4 * self.candidates_at(16)))
        residual: Tensor = self.begin_residual(x)
        return x + residual

    def regressed(self, cost: Tensor) -> Tensor:
        """Disparity [N, 1, H, W] of costs [N, D/4, H/4, W/4]: enlarged, then soft-argmin (section 3.5, eq. 1)."""
        depth, height, width = (4 * size for size in cost.shape[1:])
        return soft_argmin(trilinear(cost, (depth, height, width)))


class PSMNetBasic(_PSMNet):
    """PSMNet with the basic 3-D network, twelve layers (section 3.4, Fig. 1; "PSMNet-classic" in AnyNet's paper)."""

    loss_weights = (1.0,)

    def __init__(self, max_disparity: int = 192) -> None:
        super().__init__(max_disparity)
        self.residuals = nn.ModuleList(
            nn.Sequential(_layer3d(32, 32), _layer3d(32, 32, activate=False)) for _ in range(3)
        )
        self.head = Head()

    def estimates(self, left: Tensor, right: Tensor) -> list[Tensor]:
        x = self.volume(left, right)
        for residual in self.residuals:
            x = x + residual(x)
        return [self.regressed(self.head(x))]


class Hourglass(nn.Module):
    """One 3Dstack of Table 1: down to a quarter of the volume's size and back, with what other hourglasses saw.

    Layers: 3Dstackn_1 (stride 2, then one more), 3Dstackn_2 (the same again), 3Dstackn_3 and 3Dstackn_4 (transposed).
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        c = 2 * channels
        self.halve, self.at_half = _layer3d(channels, c, stride=2), _layer3d(c, c)
        self.at_quarter = nn.Sequential(_layer3d(c, c, stride=2), _layer3d(c, c))
        self.to_half = _enlarging(c, c, activate=True)
        self.to_whole = _enlarging(c, channels, activate=False)

    def forward(self, x: Tensor, down: Tensor | None, up: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """The result, and what the next ones want: the half-size volumes on the way down and up.

        Args:
            x: [N, C, D, H, W], sizes multiples of 4.
            down, up: of earlier ones, [N, 2C, D/2, H/2, W/2]; None in the first.
        """
        half = self.at_half(self.halve(x), up)
        enlarged = self.to_half(self.at_quarter(half), half if down is None else down)
        return self.to_whole(enlarged), half, enlarged


class PSMNet(_PSMNet):
    """PSMNet with three stacked hourglasses (section 3.4, Table 1), 5.2 million parameters.

    Training judges each hourglass' own estimate, weights 0.5, 0.7 and 1 (section 3.6).
    """

    loss_weights = (0.5, 0.7, 1.0)

    def __init__(self, max_disparity: int = 192) -> None:
        super().__init__(max_disparity)
        self.hourglasses = nn.ModuleList(Hourglass(32) for _ in range(3))
        self.heads = nn.ModuleList(Head() for _ in range(3))

    def estimates(self, left: Tensor, right: Tensor) -> list[Tensor]:
        first = x = self.volume(left, right)
        down: Tensor | None = None
        up: Tensor | None = None
        costs: list[Tensor] = []
        for hourglass, head in zip(self.hourglasses, self.heads, strict=True):
            out, half, up = hourglass(x, down, up)
            down = half if down is None else down
            x = out + first
            cost = head(x)
            costs.append(cost + costs[-1] if costs else cost)
        return [self.regressed(cost) for cost in (costs if self.training else costs[-1:])]
