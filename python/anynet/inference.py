"""The network as it runs in deployment: bytes in, batch norms folded, and nothing computed that nobody asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.network import (
    MEAN,
    STD,
    AnyNet,
    Hourglass,
    PreActivation,
    combined,
    few_channels,
    gates_of,
    halved,
    mismatch,
    run,
)

# The operators themselves: what is passed to them here needs none of the checks of their Python functions.
_ops = torch.ops.anynet


@dataclass(frozen=True)
class _Layer:
    """A convolution with what surrounds it."""

    weight: Tensor
    bias: Tensor | None = None
    scale: Tensor | None = None  # of the input, with shift; then ReLU
    shift: Tensor | None = None
    stride: int = 1
    relu_in: bool = False
    relu_out: bool = False
    gate: _Layer | None = None

    def __call__(self, x: Tensor, guide: Tensor | None = None) -> Tensor:
        if self.gate is not None:  # the layer before made x, for this one alone; gates and ReLU can change places
            assert guide is not None
            x.mul_(gates_of(self.gate(guide)))
        if not few_channels(self.weight):
            return self._large(x)
        op = _ops.conv3x3.default if self.weight.dim() == 4 else _ops.conv3x3x3.default
        out: Tensor = op(x, self.weight, self.bias, self.scale, self.shift, self.stride, self.relu_in, self.relu_out)
        return out

    def _large(self, x: Tensor) -> Tensor:
        if self.scale is not None and self.shift is not None:
            shape = [-1] + [1] * (x.dim() - 2)
            x = torch.addcmul(self.shift.view(shape), x, self.scale.view(shape))
        convolution = F.conv2d if self.weight.dim() == 4 else F.conv3d
        x = convolution(F.relu(x) if self.relu_in else x, self.weight, self.bias, self.stride, padding=1)
        return F.relu(x) if self.relu_out else x


@dataclass(frozen=True)
class _Hourglass:
    """Adds what its layers, on the way down and up again, say; with the affine and ReLU of the layer after it."""

    layers: Sequence[_Layer | _Hourglass]
    scale: Tensor
    shift: Tensor

    def __call__(self, x: Tensor, guide: Tensor | None = None) -> Tensor:
        inner = run(self.layers, x, halved(guide))
        out: Tensor = _ops.upsample_add.default(x, inner, self.scale, self.shift)
        return out


@dataclass(frozen=True)
class _Update:
    """A residual stage's network, and what it tests."""

    layers: Sequence[_Layer | _Hourglass]
    groups: int
    span: tuple[int, int]
    radius: int

    def __call__(self, features: Tensor, disparity: Tensor) -> Tensor:
        picture = _ops.candidate_costs.default(features, disparity, self.groups, *self.span, self.radius)
        cost = run(self.layers, picture)
        out: Tensor = _ops.expected_disparity.default(cost, disparity, picture[:, -2:], self.span[0])
        return out


def _grouped(features: Tensor, groups: int) -> tuple[Tensor, Tensor]:
    """The features [2, C, h, w] of a pair, [groups, C / groups, h, w] of each image."""
    left, right = features.view(2, groups, -1, *features.shape[2:])
    return left, right


def _affine(norm: nn.Module) -> tuple[Tensor, Tensor]:
    """A batch norm in eval mode, as scale and shift."""
    assert isinstance(norm, (nn.BatchNorm2d, nn.BatchNorm3d))
    assert norm.running_var is not None
    assert norm.running_mean is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return scale, norm.bias - scale * norm.running_mean


def _chain(modules: Iterable[nn.Module], activated: bool = False) -> list[_Layer | _Hourglass]:
    """A chain of pre-activation layers: each norm goes into the convolution before it.

    Args:
        activated: the chain's input has been through the first norm and ReLU; otherwise they go into its first layer.
    """
    layers: list[_Layer | _Hourglass] = []
    hourglass: Hourglass | None = None  # that waits for the layer after it
    for module in modules:
        if isinstance(module, Hourglass):
            hourglass = module
            continue
        assert isinstance(module, PreActivation)
        scale, shift = _affine(module.norm)
        gate = None if module.gate is None else _Layer(module.gate.weight)
        layer = _Layer(module.conv.weight, stride=module.conv.stride, gate=gate)
        if hourglass is not None:
            inside = _chain([hourglass.halve, *hourglass.inside, hourglass.last])
            layers.append(_Hourglass(inside, scale, shift))
            hourglass = None
        elif layers:
            before = layers[-1]
            assert isinstance(before, _Layer)
            layers[-1] = replace(before, weight=_scaled(before.weight, scale), bias=shift, relu_out=True)
        elif not activated:
            layer = replace(layer, scale=scale, shift=shift, relu_in=True)
        layers.append(layer)
    return layers


def _scaled(weight: Tensor, scale: Tensor) -> Tensor:
    """The kernels of a convolution whose outputs are multiplied by `scale`."""
    return (weight * scale.view([-1] + [1] * (weight.dim() - 1))).contiguous()


def _mirrored(layer: _Layer | _Hourglass) -> _Layer:
    """With the disparities the other way round."""
    assert isinstance(layer, _Layer)  # only the first stage has an hourglass, and it is never mirrored
    return replace(layer, weight=torch.flip(layer.weight, (2,)))


class InferenceGraph:
    """An AnyNet with its weights frozen.

    The estimates are never added up at full size before somebody wants to see one. Each stage's result stays small, and
    since pixels are areas, what the next stage needs, the sum enlarged to full size and reduced to the features' size,
    is exactly the small results enlarged to the features' size. (With `neighbours`, a stage's result is the whole
    estimate, and the sum has one term.)
    """

    @torch.no_grad()
    def __init__(self, model: AnyNet) -> None:
        self.config = model.config
        features, refinement = model.features, model.refinement
        std = 255 * torch.tensor(STD)
        self._mean, self._std = 255 * torch.tensor(MEAN), std
        scale, shift = _affine(features.halve.norm)
        assert features.first.bias is not None
        first = features.first.weight * scale[:, None, None, None] / std[:, None, None]
        self._stem = (
            self._mean,
            first.contiguous(),
            features.first.bias * scale + shift,
            features.halve.conv.weight.detach(),
            *_affine(features.down[0][0].norm),  # type: ignore[index]
            self.config.input_scale,
            self.config.input_scale * self.config.stride,
        )
        self._down, self._up = (
            [_chain(chain.children(), activated=True) for chain in part] for part in (features.down, features.up)
        )
        self._down_affine, self._up_affine = (
            [_affine(chain[0].norm) for chain in part]  # type: ignore[index]
            for part in (features.down, features.up)
        )
        self._cost_nets = [_chain(chain.children(), activated=True) for chain in model.cost_nets]
        self._cost_affine = [_affine(chain[0].norm) for chain in model.cost_nets]  # type: ignore[index]
        self._finer: _Layer | None = None
        if model.finer_costs is not None:  # what it gives is added before the ReLU
            (finer,) = _chain([model.finer_costs], activated=True)
            self._finer_affine = _affine(model.finer_costs.norm)
            begin, scale = self._cost_nets[0][0], _affine(model.cost_nets[0][1].norm)[0]  # type: ignore[index]
            assert isinstance(finer, _Layer)
            assert isinstance(begin, _Layer)
            self._finer = replace(finer, weight=_scaled(finer.weight, scale))
            self._cost_nets[0][0] = replace(begin, relu_out=False)
        self._updates = [
            _Update(_chain(update.layers.children()), update.groups, update.span, update.radius)  # type: ignore[union-attr, arg-type]
            for update in model.updates or ()
        ]
        self._ranges = list(self.config.ranges)
        self._signs = [1.0] * len(self._ranges)
        if self.config.reversed_residuals:
            # The mirrored search is the plain one with everything mirrored: range, kernels, and the result's sign.
            for i, (low, high) in enumerate(self._ranges[1:], start=1):
                self._ranges[i] = -high, -low
                self._signs[i] = -1.0
                self._cost_nets[i] = [_mirrored(layer) for layer in self._cost_nets[i]]
        *guidance, gates = [layer.get_parameter("weight").detach() for layer in refinement.guidance]
        self._guidance = [_Layer(weight, relu_out=True) for weight in guidance]
        directions = self.config.spn_directions
        # Direction by direction, so that no more than one scan's gates are in memory.
        self._gates = [_Layer(weight) for weight in gates.chunk(len(directions))]
        # glibc hands a frame's memory back to the system at every free, to fault it in again, until it has seen a block
        # freed that is larger than all of it.
        torch.empty(2**25 - 2**20, dtype=torch.uint8)
        self._expand = _Layer(refinement.expand.weight.detach())
        self._upsampling: _Layer | None = None
        if refinement.upsampling is not None:
            assert refinement.upsampling.bias is not None
            self._upsampling = _Layer(refinement.upsampling.weight.detach(), refinement.upsampling.bias.detach())
        self._reduce = _Layer(refinement.reduce.weight.detach())

    def stages(self, left: Tensor, right: Tensor) -> Iterator[Callable[[], Tensor]]:
        """One function per stage, each giving that stage's full-size disparity [H, W].

        Iterating computes a stage at low resolution; only calling the function enlarges its result.

        Args:
            left, right: uint8 RGB, [H, W, 3], contiguous.
        """
        height, width = left.shape[:2]
        maps: list[Tensor] = []  # [h, w], in pixels of the images
        scales: list[int] = []  # pixels of the images per pixel of the map

        def enlarge(maps: list[Tensor], scales: list[int]) -> Callable[[], Tensor]:
            return lambda: _ops.upsample_sum.default(maps, scales, 1.0, height, width)

        skips = self._encode(left, right)
        finer = skips[-2]
        for i, features in enumerate(self._decode(skips)):
            scale = self.config.stride >> i
            disparity = self._sum_at(scale, maps, scales, features.shape[2:]) if i else None
            if self._updates and disparity is not None:
                maps = [self._updates[i - 1](features, disparity)[0, 0].mul_(scale)]
                scales = [scale]
            else:
                maps = [*maps, self._residual(features, finer, disparity, i).mul_(scale * self._signs[i])]
                scales = [*scales, scale]
            yield enlarge(maps, scales)
        disparity = _blur(maps[-1], scales[-1])[None, None]
        if len(maps) > 1:
            disparity += self._sum_at(scales[-1], maps[:-1], scales[:-1], maps[-1].shape, gain=1.0)
        refined = self._refine(left, right, disparity)
        yield enlarge([refined], [scales[-1] * disparity.shape[3] // refined.shape[1]])

    def _residual(self, features: Tensor, finer: Tensor, disparity: Tensor | None, stage: int) -> Tensor:
        """[h, w]: what stage number `stage`, from 0, adds, in pixels of its features; `finer` is for the first one."""
        first, last = self._ranges[stage]
        layers = self._cost_nets[stage]
        x = layers[0](self._volume(features, disparity, first, last, self._cost_affine[stage]))
        if stage == 0 and self._finer is not None:
            x.add_(self._finer(self._volume(finer, None, 2 * first, 2 * last + 1, self._finer_affine))).relu_()
        cost = run(layers[1:], x, features[:1])[:, 0]
        out: Tensor = _ops.soft_argmin.default(cost, first)[0, 0]
        return out

    def _volume(
        self, features: Tensor, disparity: Tensor | None, first: int, last: int, affine: tuple[Tensor, Tensor]
    ) -> Tensor:
        """[1, groups, D, h, w] of the features [2, C, h, w] of both images, through an affine and ReLU."""
        groups = self.config.groups
        of_left, of_right = _grouped(features, groups)
        if disparity is not None:
            disparity = disparity.expand(groups, -1, -1, -1)
        out: Tensor = _ops.cost_volume_affine_relu.default(of_left, of_right, disparity, first, last, *affine)
        return out[None]

    def _encode(self, left: Tensor, right: Tensor) -> list[Tensor]:
        """The way down: [2, C, h, w] of the left image and the right one, finest first."""
        x = _ops.stem.default(left, right, *self._stem)
        skips: list[Tensor] = []
        for i, layers in enumerate(self._down):
            x = run(layers, _ops.max_pool.default(x, *self._down_affine[i]) if i else x)
            skips.append(x)
        return skips

    def _decode(self, skips: list[Tensor]) -> Iterator[Tensor]:
        """The way up: the stages' features."""
        x = skips.pop()
        yield x
        for i, layers in enumerate(self._up):
            x = run(layers, _ops.upsample_concat.default(skips.pop(), x, *self._up_affine[i]))
            yield x

    @staticmethod
    def _sum_at(
        scale: int, maps: list[Tensor], scales: list[int], size: Sequence[int], gain: float | None = None
    ) -> Tensor:
        """[1, 1, h, w]: the estimate at that scale, in its own pixels."""
        ratios = [s // scale for s in scales]
        out: Tensor = _ops.upsample_sum.default(maps, ratios, 1 / scale if gain is None else gain, *size)
        return out[None, None]

    def _refine(self, left: Tensor, right: Tensor, disparity: Tensor) -> Tensor:
        """[1, 1, h, w] at the finest features' resolution to [h, w] or, upsampled, [2h, 2w]."""
        height, width = disparity.shape[2:]
        finest = self.config.finest

        def small(image: Tensor, factor: int = finest, block: int = 1) -> Tensor:
            out: Tensor = _ops.read_image.default(image, self._mean, self._std, factor, block, height, width)
            return out

        image = small(left)
        picture = small(left, finest // 2, 2) if self._upsampling is not None else image
        if self.config.spn_fill:
            disparity = _ops.fill_occlusions.default(disparity, finest)
        if self.config.spn_mismatch:
            picture = torch.cat([picture, *mismatch(image, small(right), disparity / finest)], 1)
        guide = run(self._guidance, picture)
        x = self._expand(disparity)
        scans = []
        for layer, direction in zip(self._gates, self.config.spn_directions, strict=True):
            gates = layer(guide).view(1, 3, -1, height, width)
            scans.append(_ops.normalized_propagation.default(x, gates, direction))
        out = self._reduce(combined(scans, self.config.spn_combine))
        if self._upsampling is not None:
            out = _ops.convex_upsampling.default(out, self._upsampling(guide))
        return out[0, 0]


def _blur(x: Tensor, factor: int) -> Tensor:
    """Enlarged 2 or 4 times and reduced again: 1/8, 3/4, 1/8 or 1/16, 7/8, 1/16 along both axes; the border goes on."""
    side = 1 / (4 * factor)
    for d in (0, 1):
        n = x.shape[d]
        before = torch.cat([x.narrow(d, 0, 1), x.narrow(d, 0, n - 1)], d)
        after = torch.cat([x.narrow(d, 1, n - 1), x.narrow(d, n - 1, 1)], d)
        x = (1 - 2 * side) * x + side * (before + after)
    return x
