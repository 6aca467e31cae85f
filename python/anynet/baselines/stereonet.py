"""StereoNet (Khamis et al., "StereoNet: Guided Hierarchical Refinement for Real-Time Edge-Aware Depth Prediction",
ECCV 2018, arXiv 1807.08865): a volume at 1/8 or 1/16 of the resolution, and networks that sharpen its estimate."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.baselines.baseline import Baseline
from anynet.baselines.layers import Layer, ResidualBlock, difference_volume, leaky_relu
from anynet_ext import resize, soft_argmin

CHANNELS = 32
ACTIVATION = leaky_relu(0.2)  # section 3.1


def _block(dilation: int = 1) -> ResidualBlock:
    return ResidualBlock(CHANNELS, CHANNELS, activation=ACTIVATION, last=ACTIVATION, dilation=dilation)


class EdgeAwareRefinement(nn.Module):
    """Adds to an enlarged disparity what its image says (section 3.4, Fig. 2, right).

    A 3x3 convolution of disparity and color to 32 channels, six residual blocks of dilations 1, 2, 4, 8, 1, 1, and a
    3x3 convolution to one channel without norm or activation.
    """

    DILATIONS = (1, 2, 4, 8, 1, 1)

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            Layer(4, CHANNELS, norm=True, bias=True, activation=ACTIVATION),
            *(_block(dilation) for dilation in self.DILATIONS),
            Layer(CHANNELS, 1),
        )

    def forward(self, disparity: Tensor, image: Tensor) -> Tensor:
        """[N, 1, H, W], not negative, of the disparity [N, 1, H, W] and the image [N, 3, H, W], in its pixels."""
        return F.relu(disparity + self.layers(torch.cat([disparity, image], 1)))


class StereoNet(Baseline):
    """StereoNet with K halvings.

    Parts and their sources:
        features: K 5x5 convolutions of stride 2, six residual blocks, a 3x3 convolution without norm or activation, all
            of 32 channels (section 3.1).
        filter: four 3x3x3 convolutions with batch norm and leaky ReLU, and one to a channel, over the features'
            differences (section 3.2).
        disparity by soft-argmin (section 3.3).
        refinements: one per doubling of the resolution ("multi" in Table 1), or a single one at full size
            (section 3.4).

    Args:
        max_disparity: see `Baseline`.
        halvings: K; 3 is the 8x, 4 the 16x network.
        single: one refinement at full size instead of K.
    """

    def __init__(self, max_disparity: int = 192, *, halvings: int = 3, single: bool = False) -> None:
        super().__init__(max_disparity)
        self.stride = 2**halvings
        refinements = 1 if single else halvings
        # All estimates count alike, the first one, of the volume, included (section 3.5).
        self.loss_weights = (1.0,) * (refinements + 1)
        self.features = nn.Sequential(
            *(Layer(3 if i == 0 else CHANNELS, CHANNELS, kernel=5, stride=2) for i in range(halvings)),
            *(_block() for _ in range(6)),
            Layer(CHANNELS, CHANNELS),
        )
        self.filter = nn.Sequential(
            *(Layer(CHANNELS, CHANNELS, dims=3, norm=True, bias=True, activation=ACTIVATION) for _ in range(4)),
            Layer(CHANNELS, 1, dims=3),
        )
        self.refinements = nn.ModuleList(EdgeAwareRefinement() for _ in range(refinements))

    def estimates(self, left: Tensor, right: Tensor) -> list[Tensor]:
        matched, other = self.features(torch.cat([left, right])).chunk(2)
        volume = difference_volume(matched, other, self.candidates_at(self.stride))
        disparity = soft_argmin(self.filter(volume)[:, 0])
        estimates = [disparity]
        height, width = left.shape[2:]
        for remaining in reversed(range(len(self.refinements))):
            size = height >> remaining, width >> remaining
            enlarged = resize(disparity, size, scale=size[1] / disparity.shape[-1])
            disparity = self.refinements[len(estimates) - 1](enlarged, resize(left, size))
            estimates.append(disparity)
        if not self.training:
            return estimates[-1:]
        return [resize(estimate, (height, width), scale=width / estimate.shape[-1]) for estimate in estimates]
