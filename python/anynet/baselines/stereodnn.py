"""The small networks of StereoDNN (Smolyanskiy et al., "On the Importance of Stereo for Accurate Depth Estimation: An
Efficient Semi-Supervised Deep Neural Network Approach", CVPR workshops 2018, arXiv 1803.09719), made for the TX2.

The paper draws the architecture (Fig. 2 and 3) and measures these variants; the layers' sizes are those of the networks
that its authors published (NVIDIA-AI-IOT/redtail, stereoDNN), whose layer names are given below.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anynet.baselines.baseline import Baseline
from anynet.baselines.layers import Layer, ResidualBlock, concatenation_volume, correlation_volume, elu
from anynet_ext import soft_argmin


class Bottleneck(nn.Module):
    """An encoder and decoder around a narrow middle (conv*_1 to conv*_8, deconv*_1 to deconv*_3), all with ELU.

    Two layers, a halving, two layers, a halving, two layers; then up by transposed convolutions, adding what the way
    down had there; the last one doubles the input's size and has no activation. Twice the channels per halving.

    Args:
        inputs: channels.
        channels: of the first layers.
        dims: 2 or 3.
    """

    def __init__(self, inputs: int, channels: int, dims: int) -> None:
        super().__init__()

        def layer(inputs: int, outputs: int, stride: int = 1) -> Layer:
            return Layer(inputs, outputs, dims=dims, stride=stride, activation=elu)

        def up(inputs: int, outputs: int, *, last: bool = False) -> Layer:
            return Layer(inputs, outputs, dims=dims, stride=2, transposed=True, activation=None if last else elu)

        c = channels
        self.at_whole = nn.Sequential(layer(inputs, c), layer(c, c))  # _1, _2
        self.at_half = nn.Sequential(layer(c, 2 * c, 2), layer(2 * c, 2 * c), layer(2 * c, 2 * c))  # _3ds, _4, _5
        self.at_quarter = nn.Sequential(
            layer(2 * c, 4 * c, 2), layer(4 * c, 4 * c), layer(4 * c, 4 * c)
        )  # _6ds, _7, _8
        self.to_half, self.to_whole, self.to_double = up(4 * c, 2 * c), up(2 * c, c), up(c, 1, last=True)

    def forward(self, x: Tensor) -> Tensor:
        """[N, inputs, ..., H, W], sizes multiples of 4 -> [N, 1, ..., 2H, 2W]."""
        whole = self.at_whole(x)
        half = self.at_half(whole)
        x = self.to_half(self.at_quarter(half), half)
        out: Tensor = self.to_double(self.to_whole(x, whole))
        return out


class NVTiny(Baseline):
    """NVTiny: a volume of concatenated features at half the resolution, and a three-dimensional bottleneck.

    Features: conv1 (5x5, stride 2, 32 channels), conv2 to conv4 (3x3, 32), conv5 (3x3, 8, no activation). The published
    network is for 513x161 pixels and 48 disparities (24 at half size).
    """

    stride = 8
    loss_weights = (1.0,)

    def __init__(self, max_disparity: int = 48) -> None:
        super().__init__(max_disparity)
        self.features = nn.Sequential(
            Layer(3, 32, kernel=5, stride=2, activation=elu),
            *(Layer(32, 32, activation=elu) for _ in range(3)),
            Layer(32, 8),
        )
        self.bottleneck = Bottleneck(16, 16, dims=3)

    def estimates(self, left: Tensor, right: Tensor) -> list[Tensor]:
        left, right = self.features(torch.cat([left, right])).chunk(2)
        volume = concatenation_volume(left, right, 4 * self.candidates_at(8))
        return [soft_argmin(self.bottleneck(volume)[:, 0])]


class ResNet18Correlation(Baseline):
    """ResNet-18 2D: a correlation of residual features, and a two-dimensional bottleneck.

    Features: conv1 (5x5, stride 2, 32 channels), resblock1 to resblock8, encoder2D_out (3x3, 32, no activation). The
    disparity that correlates best, by soft-argmax, and the left image's conv1 go into the bottleneck. Its result,
    through a sigmoid, is a share: of the image's width in the published network, which knows one width, 513 pixels, and
    of `max_disparity` here. That network has 48 disparities at half size.
    """

    stride = 8
    loss_weights = (1.0,)

    def __init__(self, max_disparity: int = 96) -> None:
        super().__init__(max_disparity)
        self.first = Layer(3, 32, kernel=5, stride=2, activation=elu)
        self.features = nn.Sequential(
            *(ResidualBlock(32, 32, activation=elu, last=elu, norm=False) for _ in range(8)), Layer(32, 32)
        )
        self.bottleneck = Bottleneck(33, 32, dims=2)

    def estimates(self, left: Tensor, right: Tensor) -> list[Tensor]:
        first = self.first(torch.cat([left, right]))
        matched, other = self.features(first).chunk(2)
        guess = soft_argmin(-correlation_volume(matched, other, self.candidates_at(2)))
        share = self.bottleneck(torch.cat([first[: len(left)], guess], 1)).sigmoid()
        return [self.max_disparity * share]
