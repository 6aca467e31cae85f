"""The last stage: spatial propagation, steered by the left image (section III-D of the paper)."""

from __future__ import annotations

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.model.chains import in_chains, run
from anynet.model.config import MEAN, STD, RefinementConfig
from anynet.model.layers import Convolution, init_normal
from anynet_ext import reference, resize, spatial_propagation, warp

_ops = torch.ops.anynet

DISPARITY_SCALE = 16  # by which the guide's disparity is divided


class Refinement(nn.Module):
    """A map at the finest features' resolution, sharpened along the edges of the image."""

    def __init__(self, config: RefinementConfig, finest: int) -> None:
        super().__init__()
        c = config.channels
        self.config, self.finest = config, finest
        inputs = (12 if config.convex_upsampling else 3) + (4 if config.warp_error else 0)
        self.guidance = nn.ModuleList(
            Convolution(i, o) for i, o in pairwise([inputs, 2 * c, 2 * c, 2 * c, 3 * c * len(config.directions)])
        )
        self.expand = Convolution(1, c)
        self.reduce = Convolution(c, 1)
        self.upsampling = Convolution(2 * c, 32, bias=True) if config.convex_upsampling else None
        if self.upsampling is not None:
            assert self.upsampling.bias is not None
            nn.init.zeros_(self.upsampling.weight)
            with torch.no_grad():
                self.upsampling.bias.copy_(bilinear_logits())
        # Begins as nearly the identity: from random scales, the first hundreds of steps go into unlearning them.
        for layer, gain in ((self.expand, 1.0), (self.reduce, 1 / c)):
            init_normal(layer.weight, 0.1 * gain)
            with torch.no_grad():
                layer.weight[:, :, 1, 1] += gain

    def forward(self, left: Tensor, right: Tensor, disparity: Tensor) -> Tensor:
        """The sharpened disparity, [N, 1, h, w] or, by convex upsampling, [N, 1, 2h, 2w].

        Args:
            left, right: the images [N, 3, H, W], normalized.
            disparity: [N, 1, h, w] at the finest features' resolution, in pixels of the images.
        """
        if self.config.fill_occlusions:
            disparity = reference.fill_occlusions(disparity, self.finest, propagation=spatial_propagation)
        guide = self.guide(left, right, disparity)
        *layers, last = self.guidance
        for i, layer in enumerate(layers):
            guide = layer(guide, relu_in=i > 0)
        gates = self._normalized(last(guide, relu_in=True))
        x = self.expand(disparity)
        scans = [spatial_propagation(x, gates[:, i], d) for i, d in enumerate(self.config.directions)]
        out: Tensor = self.reduce(largest(scans))
        if self.upsampling is None:
            return out
        return reference.convex_upsampling(out, self.upsampling(guide, relu_in=True))

    def guide(self, left: Tensor, right: Tensor, disparity: Tensor) -> Tensor:
        """What the propagation is steered by: [N, 3 to 16, h, w]."""
        h, w = disparity.shape[2:]
        small = resize(left, (h, w))
        seen = F.pixel_unshuffle(resize(left, (2 * h, 2 * w)), 2) if self.config.convex_upsampling else small
        if not self.config.warp_error:
            return seen
        return torch.cat([seen, *warp_error(small, resize(right, (h, w)), disparity.detach() / self.finest)], 1)

    def _normalized(self, gates: Tensor) -> Tensor:
        """[N, directions, 3, C, h, w]; over the three neighbors, absolute values sum to 1."""
        n, _, h, w = gates.shape
        gates = gates.reshape(n, len(self.config.directions), 3, self.config.channels, h, w)
        # Not a division: the gradient of one takes four more.
        return gates * (gates.abs().sum(2, keepdim=True) + 1e-8).reciprocal()

    def deploy(self) -> DeployedRefinement:
        return DeployedRefinement(self)


class DeployedRefinement(nn.Module):
    """The same of one pair, on images in bytes."""

    def __init__(self, refinement: Refinement) -> None:
        super().__init__()
        self.config, self.finest = refinement.config, refinement.finest
        *guidance, last = refinement.guidance
        layers = [layer.deploy(relu_out=True) for layer in guidance]  # type: ignore[operator]
        if self.config.warp_error:  # whose disparity comes undivided
            *others, scaled = layers[0].weight.split([layers[0].weight.shape[1] - 1, 1], 1)
            layers[0].weight = torch.cat([*others, scaled / DISPARITY_SCALE], 1)
        self.guidance = in_chains(layers)
        # Direction by direction, so that no more than one scan's gates are in memory.
        self.gates = nn.ModuleList()
        for weight in last.weight.detach().chunk(len(self.config.directions)):  # type: ignore[operator]
            layer = last.deploy()  # type: ignore[operator]
            layer.weight = weight
            self.gates.append(layer)
        self.expand, self.reduce = refinement.expand.deploy(), refinement.reduce.deploy()
        self.upsampling = None if refinement.upsampling is None else refinement.upsampling.deploy()
        device = refinement.expand.weight.device
        self.register_buffer("mean", 255 * torch.tensor(MEAN, dtype=torch.float32, device=device))
        self.register_buffer("std", 255 * torch.tensor(STD, dtype=torch.float32, device=device))

    def forward(self, left: Tensor, right: Tensor, disparity: Tensor) -> Tensor:
        """As `Refinement.forward`; the images are uint8 RGB [H, W, 3]."""
        height, width = disparity.shape[2:]
        if self.config.fill_occlusions:
            disparity = _ops.fill_occlusions.default(disparity, self.finest)
        guide = run(self.guidance, self._guide(left, right, disparity))
        x = self.expand(disparity)
        scans = []
        for layer, direction in zip(self.gates, self.config.directions, strict=True):
            gates = layer(guide).view(1, 3, -1, height, width)
            scans.append(_ops.normalized_propagation.default(x, gates, direction))
        out: Tensor = self.reduce(largest(scans))
        if self.upsampling is not None:
            out = _ops.convex_upsampling.default(out, self.upsampling(guide))
        return out

    def _guide(self, left: Tensor, right: Tensor, disparity: Tensor) -> Tensor:
        block = 2 if self.config.convex_upsampling else 1
        if self.config.warp_error:
            out: Tensor = _ops.refinement_guide.default(left, right, disparity, self.mean, self.std, self.finest, block)
            return out
        out = _ops.read_image.default(left, self.mean, self.std, self.finest // block, block, *disparity.shape[2:])
        return out


def largest(scans: list[Tensor]) -> Tensor:
    """Of several scans' results, the largest value per pixel and channel."""
    return scans[0] if len(scans) == 1 else torch.stack(scans).amax(0)


def warp_error(left: Tensor, right: Tensor, disparity: Tensor) -> list[Tensor]:
    """How the right image, warped, differs from the left one, [N, 3, H, W]; and the disparity, scaled, [N, 1, H, W]."""
    return [warped_difference(left, right, disparity), disparity / DISPARITY_SCALE]


def warped_difference(left: Tensor, right: Tensor, disparity: Tensor) -> Tensor:
    """The right image, warped by the disparity, less the left one."""
    return warp(right, disparity) - left


def bilinear_logits() -> Tensor:
    """[32]: those of `convex_upsampling` that make it nearly bilinear, with something left to each neighbor."""
    # On the meta device, where networks are made before their weights are loaded, this would import PyTorch's compiler.
    axis = torch.tensor([[0.25, 0.75, 0.0], [0.0, 0.75, 0.25]], dtype=torch.float32, device="cpu")
    weights = torch.einsum("ai,bj->abij", axis, axis).clamp(min=0.01).view(4, 9)
    logits = (weights / weights[:, 4:5]).log()
    return torch.cat([logits[:, :4], logits[:, 5:]], 1).flatten()
