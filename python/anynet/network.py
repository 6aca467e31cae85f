"""AnyNet (Wang et al., ICRA 2019, arXiv 1810.11408): stereo depth in stages, each refining the one before."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import islice, pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.config import AnyNetConfig
from anynet.errors import AnyNetError
from anynet_ext import batch_norm_relu, conv3x3, conv3x3x3, cost_volume, resize, soft_argmin, spatial_propagation, warp

# Of ImageNet's RGB values in 0..1.
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


class Convolution(nn.Module):
    """3x3 (or 3x3x3, `dims=3`) convolution with zero padding."""

    def __init__(self, inputs: int, outputs: int, *, dims: int = 2, stride: int = 1, bias: bool = False) -> None:
        super().__init__()
        self.stride = stride
        self.weight = nn.Parameter(torch.empty(outputs, inputs, *[3] * dims))
        self.bias = nn.Parameter(torch.zeros(outputs)) if bias else None
        nn.init.normal_(self.weight, std=math.sqrt(2 / (3**dims * outputs)))

    def forward(self, x: Tensor, relu_in: bool = False) -> Tensor:
        volume = self.weight.dim() == 5
        if not few_channels(self.weight):
            convolution = F.conv3d if volume else F.conv2d
            return convolution(F.relu(x) if relu_in else x, self.weight, self.bias, self.stride, padding=1)
        return (conv3x3x3 if volume else conv3x3)(x, self.weight, self.bias, stride=self.stride, relu_in=relu_in)


def few_channels(weight: Tensor) -> bool:
    """Whether our own operators are the faster ones for a convolution of this weight."""
    outputs, inputs = weight.shape[:2]
    return outputs <= 32 and inputs <= 64


class PreActivation(nn.Module):
    """Batch norm, ReLU, convolution.

    `guide` is the number of channels of a picture that says, pixel by pixel, which channels of the volume count, or 0.
    It begins by saying nothing (Bangunharcana et al., "Correlate-and-excite", arXiv 2108.05773).
    """

    def __init__(self, inputs: int, outputs: int, *, dims: int = 2, stride: int = 1, guide: int = 0) -> None:
        super().__init__()
        self.norm = nn.BatchNorm3d(inputs) if dims == 3 else nn.BatchNorm2d(inputs)
        self.conv = Convolution(inputs, outputs, dims=dims, stride=stride)
        self.gate = Convolution(guide, inputs) if guide else None
        if self.gate is not None:
            nn.init.zeros_(self.gate.weight)

    def forward(self, x: Tensor, guide: Tensor | None = None) -> Tensor:
        x = normalised(x, self.norm)
        if self.gate is not None:
            x = x * gates_of(self.gate(guide))
        out: Tensor = self.conv(x)
        return out


def normalised(x: Tensor, norm: nn.Module) -> Tensor:
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


def gates_of(picture: Tensor) -> Tensor:
    """[N, C, H, W], any values, to factors of a volume [N, C, D, H, W]: 0 to 2."""
    return (2 * picture.sigmoid())[:, :, None]


def chain(channels: list[int]) -> nn.Sequential:
    return nn.Sequential(*(PreActivation(i, o) for i, o in pairwise(channels)))


class Hourglass(nn.Module):
    """Adds to a volume what its surroundings say: halved in all three dimensions, looked at, and enlarged again.

    Begins as the identity. Inside, it has twice the volume's channels, on every level.
    """

    def __init__(self, channels: int, inner: int, levels: int, guide: int = 0) -> None:
        super().__init__()
        self.halve = PreActivation(channels, inner, dims=3, stride=2)
        self.inside = nn.Sequential(PreActivation(inner, inner, dims=3, guide=guide))
        if levels > 1:
            self.inside.append(Hourglass(inner, inner, levels - 1, guide))
        self.last = PreActivation(inner, channels, dims=3)
        nn.init.zeros_(self.last.conv.weight)

    def forward(self, x: Tensor, guide: Tensor | None = None) -> Tensor:
        inner = run(self.inside, self.halve(x), halved(guide))
        return enlarged(self.last(inner), add=x)


def halved(guide: Tensor | None) -> Tensor | None:
    """A cost network's guide, if there is one, in the size of the volume halved."""
    return None if guide is None else F.avg_pool2d(guide, 2, ceil_mode=True)


def run(layers: Iterable[Callable[..., Tensor]], x: Tensor, guide: Tensor | None = None) -> Tensor:
    """Layers of a cost network, one after another; `guide` [N, C, H, W] is for those that want one."""
    for layer in layers:
        x = layer(x, guide)
    return x


def enlarged(volume: Tensor, add: Tensor) -> Tensor:
    """`add` [N, C, D, H, W] and the volume [N, C, d, h, w], trilinear, in its size."""
    n, c, depth, height, width = add.shape
    planes = resize(volume.flatten(1, 2), (height, width)).view(n, c, -1, height * width)
    return resize(planes, (depth, height * width), add=add.view(n, c, depth, -1)).view_as(add)


def cost_net(groups: int, channels: int, layers: int, hourglass: int = 0, guide: int = 0) -> nn.Sequential:
    """A cost volume [N, groups, D, H, W] to costs [N, 1, D, H, W]."""
    widths, middle = [groups, *[channels] * (layers + 1), 1], 1 + (layers + 1) // 2
    net = nn.Sequential(
        *(
            PreActivation(*ends, dims=3, guide=guide if i in (1, middle) else 0)
            for i, ends in enumerate(pairwise(widths))
        )
    )
    with torch.no_grad():  # begins undecided: small costs, so that no random one wins the softmax
        net.get_parameter(f"{layers + 1}.conv.weight").mul_(0.1)
    if hourglass:
        net.insert(middle, Hourglass(channels, 2 * channels, hourglass, guide))
    return net


class Update(nn.Module):
    """A residual stage's network: judges what lies around an estimate, and the nearest and farthest of its neighbours.

    Enlarged estimates blur depth edges and lose what is thinner than a coarse pixel. A neighbour may still know its
    disparity, however far that is from the estimate, and its cost tells whether it fits: the propagation of PatchMatch
    stereo (Bleyer et al., BMVC 2011). In two dimensions, the disparities tested being so many channels.

    Args:
        features: channels of the features that are compared.
        channels: of its own convolutions.
        groups: as in `AnyNetConfig`.
        span: first and last residual.
        radius: how far neighbours are away, at most, in rows and columns.
    """

    def __init__(self, features: int, channels: int, groups: int, span: tuple[int, int], radius: int) -> None:
        super().__init__()
        self.groups, self.span, self.radius = groups, span, radius
        tested = span[1] - span[0] + 3
        self.layers = chain([groups * tested + features + 2, channels, channels, tested])
        with torch.no_grad():  # begins undecided, as `cost_net` does
            self.layers.get_parameter("2.conv.weight").mul_(0.1)

    def forward(self, features: Tensor, disparity: Tensor) -> Tensor:
        """The disparity [N, 1, h, w], in pixels of the features [2N, C, h, w] of all left and then all right images."""
        near, far = neighbours(disparity, self.radius)
        volumes = [compared(features, disparity, *self.span, self.groups)]
        volumes += [compared(features, each, 0, 0, self.groups) for each in (near, far)]
        offsets = near - disparity, far - disparity
        picture = torch.cat([*(volume.flatten(1, 2) for volume in volumes), features[: len(disparity)], *offsets], 1)
        return disparity + expected_residual(self.layers(picture), self.span[0], offsets)


def neighbours(disparity: Tensor, radius: int) -> tuple[Tensor, Tensor]:
    """The largest and the smallest of a map [N, 1, h, w] around each pixel."""
    window = 2 * radius + 1
    return F.max_pool2d(disparity, window, 1, radius), -F.max_pool2d(-disparity, window, 1, radius)


def expected_residual(cost: Tensor, first: int, offsets: tuple[Tensor, Tensor]) -> Tensor:
    """Soft-argmin of costs [N, D, h, w] over the residuals from `first` on and then two maps of them [N, 1, h, w]."""
    probability = (-cost).softmax(1)
    steps = torch.arange(first, first + cost.shape[1] - 2, dtype=cost.dtype, device=cost.device)
    out = (probability[:, :-2] * steps.view(-1, 1, 1)).sum(1, keepdim=True)
    return out + probability[:, -2:-1] * offsets[0] + probability[:, -1:] * offsets[1]


def compared(features: Tensor, disparity: Tensor | None, first: int, last: int, groups: int) -> Tensor:
    """The cost volume [N, groups, D, h, w] of features [2N, C, h, w] of all left and then all right images."""
    _, c, *size = features.shape
    # The groups of a pair's channels go as so many pairs.
    left, right = features.reshape(2, -1, c // groups, *size)
    if disparity is not None:
        disparity = disparity.repeat_interleave(groups, 0)
    volume = cost_volume(left, right, disparity, first, last)
    return volume.view(-1, groups, *volume.shape[1:])


class UNet(nn.Module):
    """Features from coarse to fine (Fig. 2 of the paper)."""

    def __init__(self, config: AnyNetConfig) -> None:
        super().__init__()
        c = config.channels
        widths = config.feature_channels
        self.first = Convolution(3, c, bias=True)
        self.halve = PreActivation(c, c, stride=2)
        self.down = nn.ModuleList(
            chain([i] + [o] * config.layers) for i, o in zip([c, *widths[:-1]], widths, strict=True)
        )
        self.up = nn.ModuleList(  # in order of use, coarse to fine
            chain([widths[i] + widths[i + 1]] + [widths[i]] * config.layers) for i in reversed(range(config.blocks))
        )

    def encode(self, image: Tensor) -> list[Tensor]:
        """The way down: [N, C, h, w] at 1/4, 1/8, ..."""
        x = self.halve(self.first(image))
        skips = []
        for block in self.down:
            x = block(F.max_pool2d(x, 2))
            skips.append(x)
        return skips

    def decode(self, skips: list[Tensor]) -> Iterator[Tensor]:
        """The way up: features, coarsest first; iterating computes no finer level than was asked for, and takes `skips`
        apart."""
        x = skips.pop()
        yield x
        for block in self.up:
            skip = skips.pop()
            x = resize(x, (skip.shape[2], skip.shape[3]), align_corners=True)
            x = block(torch.cat([skip, x], 1))
            yield x


class Refinement(nn.Module):
    """Spatial propagation at the finest resolution, steered by the left image (section III-D of the paper)."""

    def __init__(self, config: AnyNetConfig) -> None:
        super().__init__()
        c = config.spn_channels
        self.directions = config.spn_directions
        self.combine = config.spn_combine
        inputs = (12 if config.spn_upsampling else 3) + (4 if config.spn_mismatch else 0)
        self.guidance = nn.ModuleList(
            Convolution(i, o) for i, o in pairwise([inputs, 2 * c, 2 * c, 2 * c, 3 * c * len(self.directions)])
        )
        self.expand = Convolution(1, c)
        self.reduce = Convolution(c, 1)
        self.upsampling = Convolution(2 * c, 32, bias=True) if config.spn_upsampling else None
        if self.upsampling is not None:
            assert self.upsampling.bias is not None
            nn.init.zeros_(self.upsampling.weight)
            with torch.no_grad():
                self.upsampling.bias.copy_(bilinear_logits())
        # Begins as nearly the identity: from random scales, the first hundreds of steps go into unlearning them.
        for layer, gain in ((self.expand, 1.0), (self.reduce, 1 / c)):
            nn.init.normal_(layer.weight, std=0.1 * gain)
            with torch.no_grad():
                layer.weight[:, :, 1, 1] += gain

    def forward(self, guide: Tensor, disparity: Tensor) -> Tensor:
        """[N,1,H,W] or, upsampled, [N,1,2H,2W]; of [N,3 to 16,H,W], [N,1,H,W] at the finest features' resolution."""
        *layers, last = self.guidance
        for i, layer in enumerate(layers):
            guide = layer(guide, relu_in=i > 0)
        gates = self._normalised(last(guide, relu_in=True))
        x = self.expand(disparity)
        scans = [spatial_propagation(x, gates[:, i], d) for i, d in enumerate(self.directions)]
        out: Tensor = self.reduce(combined(scans, self.combine))
        return out if self.upsampling is None else convex_upsampling(out, self.upsampling(guide, relu_in=True))

    def _normalised(self, gates: Tensor) -> Tensor:
        """[N, directions, 3, C, H, W]; over the three neighbours, absolute values sum to 1."""
        n, _, h, w = gates.shape
        gates = gates.reshape(n, len(self.directions), 3, -1, h, w)
        # Not a division: the gradient of one takes four more.
        return gates * (gates.abs().sum(2, keepdim=True) + 1e-8).reciprocal()


def combined(scans: list[Tensor], how: str) -> Tensor:
    """The results of several scans as one: their largest value or their mean, pixel by pixel and channel by channel."""
    if len(scans) == 1:
        return scans[0]
    together = torch.stack(scans)
    return together.amax(0) if how == "max" else together.mean(0)


def convex_upsampling(x: Tensor, logits: Tensor) -> Tensor:
    """Twice the size, each pixel a weighted mean of the nine around it: sharp edges need not blur.

    Args:
        x: [N, 1, H, W].
        logits: [N, 32, H, W], of the weights: of the four pixels that one becomes, row by row, those of its eight
            neighbours, row by row; its own is 0.

    Returns: [N, 1, 2H, 2W].

    Teed and Deng, "RAFT", arXiv 2003.12039, section 3.3.
    """
    n, _, h, w = x.shape
    padded = F.pad(x, (1, 1, 1, 1), mode="replicate")
    around = torch.stack([padded[:, 0, i : i + h, j : j + w] for i in range(3) for j in range(3)], 1)
    logits = logits.view(n, 4, 8, h, w)
    own = torch.zeros_like(logits[:, :, :1])
    weights = torch.cat([logits[:, :, :4], own, logits[:, :, 4:]], 2).softmax(2)
    return F.pixel_shuffle((weights * around[:, None]).sum(2), 2)


def bilinear_logits() -> Tensor:
    """[32]: those of `convex_upsampling` that make it nearly bilinear, with something left to each neighbour."""
    axis = torch.tensor([[0.25, 0.75, 0.0], [0.0, 0.75, 0.25]])
    weights = torch.einsum("ai,bj->abij", axis, axis).clamp(min=0.01).view(4, 9)
    logits = (weights / weights[:, 4:5]).log()
    return torch.cat([logits[:, :4], logits[:, 5:]], 1).flatten()


def hidden(disparity: Tensor) -> tuple[Tensor, Tensor]:
    """How much of each left pixel the right camera does not see, by the estimate [N, 1, H, W] itself, in its pixels.

    Returns two maps of its shape, 0 to 1: what lies beyond the right image's left border, and what lies behind
    something nearer: in the right image, a pixel from further right is left of it.
    """
    lands = torch.arange(disparity.shape[-1], dtype=disparity.dtype, device=disparity.device) - disparity
    leftmost = lands.flip(-1).cummin(-1).values.flip(-1)
    # Over two pixels, so that rounding cannot make a pixel jump from one depth to another.
    return (-lands / 2).clamp(0, 1), ((lands - leftmost - 0.5) / 2).clamp(0, 1)


def filled(disparity: Tensor, pixel: float) -> Tensor:
    """[N, 1, H, W]: what is hidden takes the disparity of the background beside it; `pixel` of its unit is a column.

    What lies outside takes that of its right, what lies behind that of its left neighbour, one after another.
    """
    with torch.no_grad():
        outside, behind = hidden(disparity / pixel)
    for mask, direction in ((outside, 1), (behind * (1 - outside), 0)):
        neighbours = F.pad(mask[:, None], (0, 0, 0, 0, 0, 0, 1, 1))  # only the one in the same row
        disparity = spatial_propagation(disparity, neighbours, direction)
    return disparity


def mismatch(left: Tensor, right: Tensor, disparity: Tensor) -> list[Tensor]:
    """How the right image, warped, differs from the left one, [N, 3, H, W]; and the disparity, scaled, [N, 1, H, W]."""
    return [warp(right, disparity) - left, disparity / 16]


class AnyNet(nn.Module):
    """Disparity of a rectified pair, as a sequence of ever better estimates.

    The images are [N, 3, H, W] float tensors: RGB in 0..1, minus the ImageNet mean, over its standard deviation
    (`anynet.network.MEAN`, `STD`); any H and W. An estimate is [N, 1, H, W], in pixels: left pixel (y, x) is
    right pixel (y, x - d).
    """

    def __init__(self, config: AnyNetConfig | None = None) -> None:
        super().__init__()
        self.config = config or AnyNetConfig()
        self.features = UNet(self.config)
        c = self.config
        coarsest, *finer = reversed(c.feature_channels)
        guide = coarsest if c.guided else 0
        self.cost_nets = nn.ModuleList(
            cost_net(c.groups, channels, c.cost_layers, *((0, 0) if i else (c.hourglass, guide)))
            for i, channels in enumerate(c.cost_channels)
            if i == 0 or not c.neighbours
        )
        self.updates: nn.ModuleList | None = None
        if c.neighbours:
            parts = zip(finer, c.cost_channels[1:], c.ranges[1:], strict=True)
            self.updates = nn.ModuleList(
                Update(width, channels, c.groups, span, c.neighbours) for width, channels, span in parts
            )
        self.finer_costs = None
        if c.finer_costs:
            self.finer_costs = PreActivation(c.groups, c.cost_channels[0], dims=3, stride=2)
            nn.init.zeros_(self.finer_costs.conv.weight)
        self.refinement = Refinement(self.config)

    def forward(self, left: Tensor, right: Tensor, stages: int | None = None) -> list[Tensor]:
        """The first `stages` estimates (default: all), each [N, 1, H, W]; differentiable."""
        if stages is not None and not 1 <= stages <= self.config.stages:
            raise AnyNetError(f"AnyNet: expected stages from 1 to {self.config.stages}, got {stages}")
        return list(islice(self.stages(left, right), stages))

    def stages(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        """The estimates one by one; each is computed, its part of the U-Net included, when it is asked for.

        Raises:
            AnyNetError: when the first estimate is asked for, if the images are not of one shape [N, 3, H, W].
        """
        if left.shape != right.shape or left.dim() != 4 or left.shape[1] != 3 or 0 in left.shape[2:]:
            raise AnyNetError(
                f"AnyNet: expected two images of one shape [N, 3, H, W], got {list(left.shape)} and {list(right.shape)}"
            )
        height, width = left.shape[2:]
        # Padding at the right and the bottom moves no pixel, and the left-to-right scan meets it last.
        padding = (0, -width % self.config.stride, 0, -height % self.config.stride)
        left, right = (F.pad(image, padding, mode="replicate") if any(padding) else image for image in (left, right))
        for estimate in self._padded_stages(left, right):
            yield estimate[..., :height, :width]

    def _padded_stages(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        height, width = left.shape[2:]
        images = torch.cat([left, right])
        if self.config.input_scale > 1:
            images = resize(images, (height * self.config.input_scale, width * self.config.input_scale))
        skips = self.features.encode(images)
        finer = skips[-2]
        groups, ranges = self.config.groups, self.config.ranges
        estimate: Tensor | None = None
        for i, features in enumerate(self.features.decode(skips)):
            h, w = features.shape[2:]
            scale = height // h
            if estimate is None:
                begin, *rest = self.cost_nets[0].children()
                x = begin(compared(features, None, *ranges[0], groups))
                if self.finer_costs is not None:
                    first, last = ranges[0]
                    x = x + self.finer_costs(compared(finer, None, 2 * first, 2 * last + 1, groups))
                cost = run(rest, x, features[: len(left)])
                estimate = resize(soft_argmin(cost[:, 0], ranges[0][0]), (height, width), scale=scale)
            else:
                known = resize(estimate, (h, w), scale=1 / scale)
                if self.updates is not None:
                    estimate = resize(self.updates[i - 1](features, known), (height, width), scale=scale)
                else:
                    residual = self._residual(features, known, i)
                    estimate = resize(residual, (height, width), scale=scale, add=estimate)
            yield estimate
        assert estimate is not None
        h, w = height // self.config.finest, width // self.config.finest
        small, estimate = resize(left, (h, w)), resize(estimate, (h, w))
        if self.config.spn_fill:
            estimate = filled(estimate, self.config.finest)
        guide = [F.pixel_unshuffle(resize(left, (2 * h, 2 * w)), 2) if self.config.spn_upsampling else small]
        if self.config.spn_mismatch:
            guide += mismatch(small, resize(right, (h, w)), estimate.detach() / self.config.finest)
        yield resize(self.refinement(torch.cat(guide, 1), estimate), (height, width))

    def _residual(self, features: Tensor, known: Tensor, stage: int) -> Tensor:
        """What stage number `stage`, from 0, adds to the estimate [N, 1, h, w], all in pixels of its features."""
        first, last = self.config.ranges[stage]
        if self.config.reversed_residuals:
            volume = compared(features, known, -last, -first, self.config.groups).flip(2)
        else:
            volume = compared(features, known, first, last, self.config.groups)
        return soft_argmin(self.cost_nets[stage](volume)[:, 0], first)
