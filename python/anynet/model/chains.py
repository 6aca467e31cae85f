"""Layers one after another, with hourglasses among them: as they train, and as they are deployed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.model.layers import Affine, Deployed, DeployedConvolution, DeployedExcitation, PreActivation, affine_of
from anynet_ext import resize

_ops = torch.ops.anynet


def chain(channels: list[int]) -> nn.Sequential:
    return nn.Sequential(*(PreActivation(i, o) for i, o in pairwise(channels)))


class Hourglass(nn.Module):
    """Adds to a volume or picture what its surroundings say: halved in all dimensions, looked at, and enlarged again.

    Begins as the identity. Inside, it has `inner` channels, on every level.
    """

    def __init__(self, channels: int, inner: int, levels: int, guide: int = 0, *, dims: int = 3) -> None:
        super().__init__()
        self.down = PreActivation(channels, inner, dims=dims, stride=2)
        self.inner = nn.Sequential(PreActivation(inner, inner, dims=dims, guide=guide))
        if levels > 1:
            self.inner.append(Hourglass(inner, inner, levels - 1, guide, dims=dims))
        self.up = PreActivation(inner, channels, dims=dims)
        nn.init.zeros_(self.up.conv.weight)

    def forward(self, x: Tensor, guide: Tensor | None = None) -> Tensor:
        return upsample_add(x, self.up(run(self.inner, self.down(x), _halved(guide))))

    def deploy(self, affine_out: Affine) -> DeployedHourglass:
        """With the norm and ReLU of the layer after it."""
        return DeployedHourglass(deploy_chain([self.down, *self.inner, self.up]), affine_out)


class DeployedHourglass(Deployed):
    """relu(scale (x + what its layers say, enlarged) + shift)."""

    def __init__(self, layers: nn.ModuleList, affine: Affine) -> None:
        super().__init__()
        self.layers, self.add = layers, DeployedUpsampleAdd(affine)

    def forward(self, x: Tensor, guide: Tensor | None = None) -> Tensor:
        out: Tensor = self.add(x, run(self.layers, x, _halved(guide)))
        return out


def _halved(guide: Tensor | None) -> Tensor | None:
    """The guide in the size of the volume halved; a window at an odd side's end repeats its last row or column.

    `ceil_mode` would say the same, but `torch.export` cannot solve its guards for every size.
    """
    return None if guide is None else F.avg_pool2d(F.pad(guide, (0, 1, 0, 1), "replicate"), 2)


def upsample_add(x: Tensor, coarse: Tensor) -> Tensor:
    """`x` [N, C, (D,) H, W] plus the volume or picture [N, C, (d,) h, w], linear, in its size."""
    if x.dim() == 4:
        return resize(coarse, (x.shape[2], x.shape[3]), add=x)
    n, c, depth, height, width = x.shape
    planes = resize(coarse.flatten(1, 2), (height, width)).view(n, c, -1, height * width)
    return resize(planes, (depth, height * width), add=x.view(n, c, depth, -1)).view_as(x)


class DeployedUpsampleAdd(Deployed):
    """relu(scale `upsample_add(x, coarse)` + shift)."""

    scale: Tensor
    shift: Tensor

    def __init__(self, affine: Affine) -> None:
        super().__init__()
        self.register_buffer("scale", affine[0])
        self.register_buffer("shift", affine[1])

    def forward(self, x: Tensor, coarse: Tensor) -> Tensor:
        if x.dim() == 4:
            out: Tensor = self(x[:, :, None], coarse[:, :, None])[:, :, 0]
            return out
        out = _ops.upsample_add.default(x, coarse, self.scale, self.shift)
        return out


def run(layers: Iterable[Callable[..., Tensor]], x: Tensor, guide: Tensor | None = None) -> Tensor:
    """Layers one after another; `guide` [N, C, H, W] is for those that have an excitation."""
    for layer in layers:
        x = layer(x, guide) if isinstance(layer, _GUIDED) else layer(x)
    return x


_GUIDED = PreActivation, Hourglass, DeployedExcitation, DeployedHourglass


def deploy_chain(layers: Sequence[nn.Module], *, activated: bool = False) -> nn.ModuleList:
    """Pre-activation layers and hourglasses, deployed: each norm goes into the layer before it.

    Args:
        activated: the input has been through the first norm and ReLU; otherwise they go into the first layer.
    """
    deployed = nn.ModuleList()
    for layer, following in pairwise([*layers, None]):
        if isinstance(layer, Hourglass):
            assert isinstance(following, PreActivation)
            deployed.append(layer.deploy(affine_of(following.norm)))
        else:
            assert isinstance(layer, PreActivation)
            affine_in = None if activated or len(deployed) else affine_of(layer.norm)
            affine_out = affine_of(following.norm) if isinstance(following, PreActivation) else None
            deployed.append(layer.deploy(affine_in, affine_out))
    return in_chains(deployed)


class DeployedChain(Deployed):
    """Convolutions one after another, in one operator, as long as all of them are computed by ours."""

    def __init__(self, layers: Sequence[DeployedConvolution]) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers)
        self._tensors = [layer._buffers for layer in layers]
        self._relu_out, self._ours = layers[-1]._relu_out, True

    def for_gpu(self, dtype: torch.dtype) -> None:
        """All of them; see `DeployedConvolution.for_gpu`."""
        for layer in self.layers:
            layer.for_gpu(dtype)  # type: ignore[operator]
        self._ours = all(layer._ours for layer in self.layers)

    def forward(self, x: Tensor) -> Tensor:
        if not self._ours:
            for layer in self.layers:
                x = layer(x)
            return x
        weights, biases = [own["weight"] for own in self._tensors], [own["bias"] for own in self._tensors]
        out: Tensor = _ops.conv_chain.default(x, weights, biases, self._relu_out)
        return out


def in_chains(layers: Iterable[nn.Module]) -> nn.ModuleList:
    """The layers, in one operator those that can be: what lies between two calls takes as long as a small layer."""
    grouped = nn.ModuleList()
    run: list[DeployedConvolution] = []

    def end() -> None:
        if run:
            grouped.append(run[0] if len(run) == 1 else DeployedChain(run))
            run.clear()

    for layer in layers:
        if not isinstance(layer, DeployedConvolution) or not layer.plain:
            end()
            grouped.append(layer)
            continue
        if run and not run[-1]._relu_out:
            end()
        run.append(layer)
    end()
    return grouped
