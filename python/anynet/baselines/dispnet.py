"""DispNetC (Mayer et al., "A Large Dataset to Train Convolutional Networks for Disparity, Optical Flow, and Scene Flow
Estimation", CVPR 2016, arXiv 1512.02134): a correlation of features, then a U-Net of two-dimensional layers."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anynet.baselines.baseline import Baseline
from anynet.baselines.layers import Layer, correlation_volume, leaky_relu
from anynet_ext import resize

ACTIVATION = leaky_relu(0.1)  # as FlowNet (Dosovitskiy et al., arXiv 1504.06852), which it follows


def _layer(inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1) -> Layer:
    return Layer(inputs, outputs, kernel=kernel, stride=stride, activation=ACTIVATION)


class Expansion(nn.Module):
    """One step up (Table 1, rows upconv, iconv and pr): twice the resolution, with what the way down had there.

    Args:
        inputs, outputs: channels below and here.
        skip: channels of the way down.
    """

    def __init__(self, inputs: int, outputs: int, skip: int) -> None:
        super().__init__()
        self.up = nn.ConvTranspose2d(inputs, outputs, 4, stride=2, padding=1)
        self.join = Layer(outputs + skip + 1, outputs)
        self.predict = Layer(outputs, 1)

    def forward(self, x: Tensor, disparity: Tensor, skip: Tensor) -> tuple[Tensor, Tensor]:
        """Features [N, outputs, 2h, 2w] and disparity [N, 1, 2h, 2w], in its pixels."""
        size = skip.shape[2], skip.shape[3]
        enlarged = resize(disparity, size, scale=2)
        x = self.join(torch.cat([ACTIVATION(self.up(x)), enlarged, skip], 1))
        return x, self.predict(x)


class DispNetC(Baseline):
    """DispNet with a one-dimensional correlation, 42 million parameters.

    Table 1 for the layers, section 5.1 for the correlation: after conv2, over 40 pixels there, 160 of the images. The
    table's conv1, conv2 run on both images; conv_redir (1x1, 64 channels) takes the left features past the correlation,
    as in FlowNetC. Predictions are in pixels of their own resolution. The paper moves the loss step by step from the
    coarsest prediction to the finest; here the weights stay, halved from one to the next coarser.

    Args:
        max_disparity: see `Baseline`. The correlation covers it, 160 in the paper; predictions may exceed it.
    """

    stride = 64
    loss_weights = tuple(2.0**-i for i in reversed(range(6)))

    def __init__(self, max_disparity: int = 160) -> None:
        super().__init__(max_disparity)
        self.shifts = self.candidates_at(4) + 1
        self.conv1 = _layer(3, 64, kernel=7, stride=2)
        self.conv2 = _layer(64, 128, kernel=5, stride=2)
        self.redirect = _layer(128, 64, kernel=1)
        self.conv3 = nn.Sequential(_layer(64 + self.shifts, 256, kernel=5, stride=2), _layer(256, 256))
        self.conv4 = nn.Sequential(_layer(256, 512, stride=2), _layer(512, 512))
        self.conv5 = nn.Sequential(_layer(512, 512, stride=2), _layer(512, 512))
        self.conv6 = nn.Sequential(_layer(512, 1024, stride=2), _layer(1024, 1024))
        self.predict = Layer(1024, 1)
        self.expansions = nn.ModuleList(
            Expansion(*channels)
            for channels in ((1024, 512, 512), (512, 256, 512), (256, 128, 256), (128, 64, 128), (64, 32, 64))
        )

    def estimates(self, left: Tensor, right: Tensor) -> list[Tensor]:
        first = self.conv1(torch.cat([left, right]))
        second = self.conv2(first)
        matched, other = second.chunk(2)
        correlation = correlation_volume(matched, other, self.shifts) / matched.shape[1]
        third = self.conv3(torch.cat([self.redirect(matched), ACTIVATION(correlation)], 1))
        fourth = self.conv4(third)
        fifth = self.conv5(fourth)
        x = self.conv6(fifth)
        disparity = self.predict(x)
        predictions = [disparity]
        for expansion, skip in zip(self.expansions, (fifth, fourth, third, matched, first[: len(left)]), strict=True):
            x, disparity = expansion(x, disparity, skip)
            predictions.append(disparity)
        size = left.shape[2], left.shape[3]
        chosen = predictions if self.training else predictions[-1:]
        return [resize(prediction, size, scale=size[1] / prediction.shape[-1]) for prediction in chosen]
