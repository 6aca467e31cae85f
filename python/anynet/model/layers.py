"""Convolutions with what surrounds them: as they train, and as they are deployed, with batch norms folded into them."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet_ext import batch_norm_relu, conv3x3, conv3x3x3, reference

# The operators themselves: what deployed layers pass to them needs none of the checks of their Python functions.
_ops = torch.ops.anynet

Affine = tuple[Tensor, Tensor]  # scale and shift per channel
# Channels in and out from which on cuDNN's convolutions are faster than ours on a GPU (measured on an H100): in half
# types as many as tensor cores take at a time.
CUDNN_CHANNELS = {torch.float32: 16, torch.bfloat16: 8, torch.float16: 8}


class Convolution(nn.Module):
    """3x3 (or 3x3x3, `dims=3`) convolution with zero padding."""

    def __init__(self, inputs: int, outputs: int, *, dims: int = 2, stride: int = 1, bias: bool = False) -> None:
        super().__init__()
        self.stride = stride
        self.weight = nn.Parameter(torch.empty(outputs, inputs, *[3] * dims))
        self.bias = nn.Parameter(torch.zeros(outputs)) if bias else None
        init_normal(self.weight, math.sqrt(2 / (3**dims * outputs)))

    def forward(self, x: Tensor, relu_in: bool = False) -> Tensor:
        if not few_channels(self.weight):
            return reference.conv3x3(x, self.weight, self.bias, stride=self.stride, relu_in=relu_in)
        convolution = conv3x3x3 if self.weight.dim() == 5 else conv3x3
        return convolution(x, self.weight, self.bias, stride=self.stride, relu_in=relu_in)

    def deploy(
        self, affine_in: Affine | None = None, affine_out: Affine | None = None, *, relu_out: bool = False
    ) -> DeployedConvolution:
        """Frozen; `affine_in` (then ReLU) is of its inputs, `affine_out` of its outputs."""
        weight, bias = self.weight.detach(), None if self.bias is None else self.bias.detach()
        if affine_out is not None:
            scale, shift = affine_out
            weight = (weight * scale.view(-1, *[1] * (weight.dim() - 1))).contiguous()
            bias = shift if bias is None else shift + scale * bias
        return DeployedConvolution(weight, bias, affine_in, self.stride, relu_out)


def init_normal(weight: Tensor, std: float) -> None:
    """Random values; none on the meta device, where they would only import PyTorch's compiler."""
    if not weight.is_meta:
        nn.init.normal_(weight, std=std)


def few_channels(weight: Tensor, *, on_gpu: bool | None = None) -> bool:
    """Whether our own operators are the faster ones for a convolution of this weight. (They take up to 64 channels.)

    `on_gpu`: where it is computed. None: where it is.
    """
    outputs, inputs = weight.shape[:2]
    return outputs <= (32 if (weight.is_cuda if on_gpu is None else on_gpu) else 64) and inputs <= 64


class Deployed(nn.Module):
    """A layer of the deployed network. Calling it is its `forward`: a frame has dozens of them, and none has hooks."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.__call__ = cls.forward  # type: ignore[method-assign]


class DeployedConvolution(Deployed):
    """relu_out(weight * relu(scale x + shift) + bias), in one operator."""

    weight: Tensor

    def __init__(self, weight: Tensor, bias: Tensor | None, affine: Affine | None, stride: int, relu_out: bool) -> None:
        super().__init__()
        scale, shift = affine or (None, None)
        for name, value in (("weight", weight), ("bias", bias), ("scale", scale), ("shift", shift)):
            self.register_buffer(name, value)
        self._stride, self._relu_in, self._relu_out = stride, affine is not None, relu_out
        self._ours = few_channels(weight)

    @property
    def plain(self) -> bool:
        """Of stride 1 and few channels, with nothing before it."""
        return self._stride == 1 and self._ours and not self._relu_in

    def for_gpu(self, dtype: torch.dtype) -> None:
        """Computes in this type from now on, by PyTorch, where that is faster on a GPU. Inputs and results are float32.

        Layers of few channels are cheap, and the inputs or results of one channel are disparities or costs.
        """
        self._ours = few_channels(self.weight, on_gpu=True)
        if min(self.weight.shape[:2]) >= CUDNN_CHANNELS[dtype]:
            self._ours = False
            if dtype != torch.float32:
                self.to(dtype)
                self.weight = self.weight.contiguous(memory_format=_channels_last(self.weight))

    def forward(self, x: Tensor) -> Tensor:
        own = self._buffers  # a small convolution takes no longer than four attributes of a module
        weight, bias, scale, shift = own["weight"], own["bias"], own["scale"], own["shift"]
        assert weight is not None
        if not self._ours:
            half = weight.dtype != x.dtype
            out = reference.conv3x3(
                x.to(weight.dtype, memory_format=_channels_last(x)) if half else x, weight, bias, stride=self._stride,
                scale=scale, shift=shift, relu_in=self._relu_in, relu_out=self._relu_out,
            )  # fmt: skip
            return out.to(x.dtype, memory_format=torch.contiguous_format) if half else out
        op = _ops.conv3x3.default if weight.dim() == 4 else _ops.conv3x3x3.default
        result: Tensor = op(x, weight, bias, scale, shift, self._stride, self._relu_in, self._relu_out)
        return result


def _channels_last(x: Tensor) -> torch.memory_format:
    """The layout that tensor cores take."""
    return torch.channels_last if x.dim() == 4 else torch.channels_last_3d


class PreActivation(nn.Module):
    """Batch norm, ReLU, excitation where there is one, convolution.

    `guide` is the number of channels of the picture that the excitation is made from, or 0 for none. It begins by
    weighing all channels alike.
    """

    def __init__(self, inputs: int, outputs: int, *, dims: int = 2, stride: int = 1, guide: int = 0) -> None:
        super().__init__()
        self.norm = nn.BatchNorm3d(inputs) if dims == 3 else nn.BatchNorm2d(inputs)
        self.conv = Convolution(inputs, outputs, dims=dims, stride=stride)
        self.excitation = Convolution(guide, inputs) if guide else None
        if self.excitation is not None:
            nn.init.zeros_(self.excitation.weight)

    def forward(self, x: Tensor, guide: Tensor | None = None) -> Tensor:
        x = norm_relu(x, self.norm)
        if self.excitation is not None:
            x = x * excitation_weights(self.excitation(guide), x)
        out: Tensor = self.conv(x)
        return out

    def deploy(self, affine_in: Affine | None, affine_out: Affine | None, *, relu_out: bool = True) -> nn.Module:
        """Its convolution, with the norm and ReLU before it, where the input has not been through them, and the next
        layer's after it."""
        conv = self.conv.deploy(affine_in, affine_out, relu_out=relu_out and affine_out is not None)
        if self.excitation is None:
            return conv
        conv.weight = 2 * conv.weight  # the excitation's weights are 2 sigmoid
        return DeployedExcitation(self.excitation.deploy(), conv)


class DeployedExcitation(Deployed):
    """A convolution whose input, already activated, is weighed first, in place: it is nobody else's.

    By half of what it is to be weighed; the convolution's weights are twice what they were.
    """

    def __init__(self, excitation: DeployedConvolution, conv: DeployedConvolution) -> None:
        super().__init__()
        self.excitation, self.conv = excitation, conv

    def forward(self, x: Tensor, guide: Tensor) -> Tensor:
        out: Tensor = self.conv(x.mul_(_per_plane(self.excitation(guide).sigmoid_(), x)))
        return out


def excitation_weights(logits: Tensor, x: Tensor) -> Tensor:
    """[N, C, H, W], any values, to weights of a picture or volume `x` [N, C, (D,) H, W]: 0 to 2."""
    return _per_plane(2 * logits.sigmoid(), x)


def _per_plane(weights: Tensor, x: Tensor) -> Tensor:
    """[N, C, H, W] for a picture or volume `x`, all of whose planes they weigh."""
    return weights if x.dim() == 4 else weights[:, :, None]


def norm_relu(x: Tensor, norm: nn.Module) -> Tensor:
    """`relu(norm(x))` of a batch norm; in training, it tracks its statistics as PyTorch's does."""
    if not (isinstance(norm, (nn.BatchNorm2d, nn.BatchNorm3d)) and norm.training):
        return F.relu(norm(x), inplace=True)
    out, mean, variance = batch_norm_relu(x, norm.weight, norm.bias, eps=norm.eps)
    track(norm, mean, variance, x.numel() // x.shape[1])
    return out


@torch.no_grad()
def track(norm: nn.modules.batchnorm._BatchNorm, mean: Tensor, variance: Tensor, count: int | Tensor) -> None:
    """Moves a batch norm's running statistics towards those of a batch of `count` values per channel."""
    # The types allow for batch norms that track nothing.
    assert norm.running_mean is not None
    assert norm.running_var is not None
    assert norm.num_batches_tracked is not None
    assert norm.momentum is not None
    norm.running_mean.lerp_(mean, norm.momentum)
    norm.running_var.lerp_(variance * (count / (count - 1)), norm.momentum)
    norm.num_batches_tracked.add_(1)


def affine_of(norm: nn.Module) -> Affine:
    """A batch norm in eval mode, as scale and shift."""
    assert isinstance(norm, (nn.BatchNorm2d, nn.BatchNorm3d))
    assert norm.running_var is not None
    assert norm.running_mean is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return scale.detach(), (norm.bias - scale * norm.running_mean).detach()
