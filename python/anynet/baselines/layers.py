"""What the networks are made of: one kind of layer, residual blocks of it, and volumes of matching candidates."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.model.layers import few_channels, norm_relu
from anynet_ext import conv3x3, conv3x3x3, resize, warp

Activation = Callable[[Tensor], Tensor]

relu: Activation = F.relu
elu: Activation = F.elu


def leaky_relu(slope: float) -> Activation:
    """`x` where it is positive, else `slope * x`."""
    return partial(F.leaky_relu, negative_slope=slope)


class Layer(nn.Module):
    """Convolution, batch norm if wanted, a tensor added if given, activation if wanted.

    Padding keeps the size; a stride of 2 halves it (odd sizes round up), and with `transposed` doubles it. Weights
    begin as He et al. (arXiv 1502.01852) draw them.

    Args:
        inputs, outputs: channels.
        kernel: odd.
        dims: 2 for [N, C, H, W], 3 for [N, C, D, H, W].
        norm: batch norm after the convolution, which then has no bias unless `bias` says so.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        kernel: int = 3,
        stride: int = 1,
        dilation: int = 1,
        dims: int = 2,
        norm: bool = False,
        bias: bool | None = None,
        activation: Activation | None = None,
        transposed: bool = False,
    ) -> None:
        super().__init__()
        self.stride, self.dilation, self.transposed, self.activation = stride, dilation, transposed, activation
        ends = (inputs, outputs) if transposed else (outputs, inputs)
        self.weight = nn.Parameter(torch.empty(*ends, *[kernel] * dims))
        nn.init.normal_(self.weight, std=(2 / (inputs * kernel**dims)) ** 0.5)
        self.bias = nn.Parameter(torch.zeros(outputs)) if (not norm if bias is None else bias) else None
        self.norm = (nn.BatchNorm2d(outputs) if dims == 2 else nn.BatchNorm3d(outputs)) if norm else None

    def forward(self, x: Tensor, add: Tensor | None = None) -> Tensor:
        if self.norm is None:
            x = self._convolution(x, self.weight, self.bias)
        elif not self.training:
            x = self._convolution(x, *self._folded(self.norm))
        else:
            x = self._convolution(x, self.weight, self.bias)
            if add is None and self.activation is relu:
                return norm_relu(x, self.norm)
            x = self.norm(x)
        x = x if add is None else x + add
        return x if self.activation is None else self.activation(x)

    def _folded(self, norm: nn.BatchNorm2d | nn.BatchNorm3d) -> tuple[Tensor, Tensor]:
        """Weight and bias of one convolution that does what the convolution and the running batch norm do."""
        assert norm.running_mean is not None
        assert norm.running_var is not None
        scale = norm.weight * (norm.running_var + norm.eps).rsqrt()
        ends = (1, -1) if self.transposed else (-1, 1)
        shift = norm.bias - scale * norm.running_mean
        bias = shift if self.bias is None else shift + scale * self.bias
        return self.weight * scale.view(*ends, *[1] * (self.weight.dim() - 2)), bias

    def _convolution(self, x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        volume = weight.dim() == 5
        padding = self.dilation * (weight.shape[-1] // 2)
        if self.transposed:
            transposed = F.conv_transpose3d if volume else F.conv_transpose2d
            return transposed(x, weight, bias, self.stride, padding, output_padding=self.stride - 1)
        if weight.shape[-1] == 3 and self.dilation == 1 and few_channels(weight):
            return (conv3x3x3 if volume else conv3x3)(x, weight, bias, stride=self.stride)
        convolution = F.conv3d if volume else F.conv2d
        return convolution(x, weight, bias, self.stride, padding, self.dilation)


class ResidualBlock(nn.Module):
    """Two layers whose result is added to their input (He et al., arXiv 1512.03385, Fig. 2).

    Where the shape changes, a 1x1 convolution brings the input into the new one.

    Args:
        activation: within the block.
        last: after the addition.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        activation: Activation,
        last: Activation | None = None,
        stride: int = 1,
        dilation: int = 1,
        norm: bool = True,
    ) -> None:
        super().__init__()
        self.first = Layer(inputs, outputs, stride=stride, dilation=dilation, norm=norm, activation=activation)
        self.second = Layer(outputs, outputs, dilation=dilation, norm=norm, activation=last)
        self.shortcut = (
            None if stride == 1 and inputs == outputs else Layer(inputs, outputs, kernel=1, stride=stride, norm=norm)
        )

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.second(self.first(x), x if self.shortcut is None else self.shortcut(x))
        return out


def candidates(right: Tensor, count: int) -> list[Tensor]:
    """`count` times [N, C, H, W]: features of the right view, moved by 0, 1, ... columns; zero beyond the image."""
    n, _, h, w = right.shape
    return [warp(right, right.new_full((n, 1, h, w), disparity)) for disparity in range(count)]


def concatenation_volume(left: Tensor, right: Tensor, count: int) -> Tensor:
    """[N, 2C, count, H, W]: the left features and, below them, their candidates (GC-Net, arXiv 1703.04309)."""
    return torch.stack([torch.cat([left, candidate], 1) for candidate in candidates(right, count)], 2)


def difference_volume(left: Tensor, right: Tensor, count: int) -> Tensor:
    """[N, C, count, H, W]: the left features minus their candidates, channel by channel."""
    return torch.stack([left - candidate for candidate in candidates(right, count)], 2)


def correlation_volume(left: Tensor, right: Tensor, count: int) -> Tensor:
    """[N, count, H, W]: scalar products of the left features with their candidates."""
    return torch.stack([(left * candidate).sum(1) for candidate in candidates(right, count)], 1)


def trilinear(volume: Tensor, size: tuple[int, int, int]) -> Tensor:
    """A volume [N, d, h, w] enlarged to [N, D, H, W], size (D, H, W)."""
    depth, height, width = size
    planes = resize(volume, (height, width)).view(len(volume), 1, -1, height * width)
    return resize(planes, (depth, height * width)).view(-1, depth, height, width)
