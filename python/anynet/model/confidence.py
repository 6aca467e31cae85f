"""How far to trust an estimate: a logistic regression on what the network has at hand (docs/confidence.md)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from anynet.errors import AnyNetError, one_line
from anynet.io.files import read_text, write_atomically
from anynet.model.deploy import DeployedAnyNet, StageResult, sum_at
from anynet.model.graphs import GraphedAnyNet
from anynet.model.refinement import warped_difference
from anynet_ext import reference

_ops = torch.ops.anynet

PIXEL = 0.25  # added to lengths before their logarithm; what is less does not matter
SHADE = 0.02  # the same of differences between normalized colors
HIDDEN = 1.0  # pixels by which something lies behind another, or outside, before it counts as occluded


@dataclass(frozen=True)
class Evidence:
    """At the finest features' resolution, one pixel per `scale` of the images.

    Attributes:
        channels: [F, h, w], the logarithms of: the disparity; how far it varies around the pixel; by how much it lies
            behind something nearer in the right image, and outside of it; the standard deviations of the last two
            stages' softmax; what the last stage changed; the warp error; the texture.
        hidden: [h, w], pixels by which it lies behind something nearer, or outside the right image.
        scale: pixels of the images per pixel.
    """

    channels: Tensor
    hidden: Tensor
    scale: int


def evidence_count(stage: int, last: bool) -> int:
    """Channels of the evidence on a stage, from 1; the last one has no softmax of its own."""
    return 6 + min(stage, 2 - last) + (stage > 1)


def gather_evidence(
    network: DeployedAnyNet | GraphedAnyNet, result: StageResult, left: Tensor, right: Tensor, pixel: float = 1.0
) -> Evidence:
    """The evidence on a stage's result.

    Args:
        left, right: the images that the network was given, [H, W, 3] uint8.
        pixel: the unit for lengths, over the pixel of these images.
    """
    refinement, scale = network.refinement, network.config.finest
    size = [n * result.scales[0] // scale for n in result.maps[0].shape]
    steps = [result] if result.before is None else [result, result.before]
    disparity, *before = (_at(step, scale, size) for step in steps)
    deviations = [
        sum_at([distribution.deviation()], [stride // scale], size, [stride])
        for distribution, stride in (step.spread for step in steps if step.spread is not None)
    ]
    outside, behind = (scale * distance for distance in reference.occlusion_distances(disparity / scale))
    outside.clamp_(min=0)
    small_left, small_right = (
        _ops.read_image.default(image, refinement.mean, refinement.std, scale, 1, *size) for image in (left, right)
    )
    error = warped_difference(small_left, small_right, disparity[None, None] / scale).abs().mean(1)
    texture = (small_left[0, :, :, 2:] - small_left[0, :, :, :-2]).abs().mean(0)
    lengths = [disparity.clamp(min=0), _variation(disparity), behind, outside, *deviations]
    lengths += [(disparity - other).abs() for other in before]
    channels = torch.stack([*lengths, *_mean3x3(torch.stack([error[0], F.pad(texture, (1, 1))]))])
    channels[: len(lengths)].mul_(pixel).add_(PIXEL)
    channels[len(lengths) :].add_(SHADE)
    return Evidence(channels.log_(), torch.maximum(behind, outside) * pixel, scale)


def _at(result: StageResult, scale: int, size: list[int]) -> Tensor:
    if result.scales[0] < scale:  # by convex upsampling
        return F.avg_pool2d(result.maps[0][None, None], scale // result.scales[0])[0, 0]
    return result.at(scale, size)


def _mean3x3(x: Tensor) -> Tensor:
    """`avg_pool2d` of 3 x 3, five times as fast."""
    x = F.pad(x, (1, 1, 1, 1))
    x = x[:, :, :-2] + x[:, :, 1:-1] + x[:, :, 2:]
    return (x[:, :-2] + x[:, 1:-1] + x[:, 2:]).div_(9)


def _variation(disparity: Tensor) -> Tensor:
    """Largest less smallest value of blocks of 4 x 4 and their neighbors."""
    height, width = disparity.shape
    padded = F.pad(disparity[None], (0, -width % 4, 0, -height % 4), mode="replicate")[0]
    rows = padded.view(-1, 4, padded.shape[1])  # by rows first: twice as fast as a pooling
    blocks = torch.stack([rows.amax(1), -rows.amin(1)]).view(1, 2, len(rows), -1, 4).amax(-1)
    return sum_at([F.max_pool2d(blocks, 3, 1, 1)[0].sum(0)], [4], disparity.shape)


@dataclass(frozen=True)
class ConfidenceModel:
    """The regressions' coefficients, stage by stage.

    Attributes:
        single: [F + 1] each, of the evidence, and the constant.
        checked: [F + 2] each, of the evidence, of the difference to the right view's disparity, and the constant.
    """

    single: list[Tensor]
    checked: list[Tensor]

    @classmethod
    def read(cls, path: Path, stages: int) -> ConfidenceModel:
        """From a JSON file of `write`.

        Raises:
            AnyNetError: if it does not hold finite coefficients for a network of so many stages.
        """
        text = read_text(path)
        try:
            content = json.loads(text)
            models = [[torch.tensor(row, dtype=torch.float32) for row in content[name]] for name in _FIELDS]
        except (ValueError, TypeError, KeyError, OverflowError, RuntimeError, RecursionError) as error:
            raise AnyNetError(f"{path}: not a confidence model: {one_line(error)}") from None
        for rows, more in zip(models, (1, 2), strict=True):
            expected = [evidence_count(stage, stage == stages) + more for stage in range(1, stages + 1)]
            got = [row.numel() if row.dim() == 1 and bool(row.isfinite().all()) else 0 for row in rows]
            if got != expected:
                raise AnyNetError(f"{path}: expected {expected} finite coefficients, got {got}")
        return cls(*models)

    def to(self, device: torch.device) -> ConfidenceModel:
        return ConfidenceModel(*([row.to(device) for row in getattr(self, name)] for name in _FIELDS))

    def write(self, path: Path) -> None:
        content = {name: [[round(float(v), 5) for v in row] for row in getattr(self, name)] for name in _FIELDS}
        write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())

    def probability(
        self, stage: int, evidence: Evidence, size: tuple[int, int], difference: Tensor | None = None
    ) -> Tensor:
        """[H, W]: that the disparity is less than 3 pixels or 5 % off.

        Args:
            stage: from 1.
            size: H, W of the images that the network was given.
            difference: [H, W], pixels, of the right view's disparity; None: not known.
        """
        coefficients = (self.single if difference is None else self.checked)[stage - 1]
        count = len(evidence.channels)
        logit = (coefficients[:count] @ evidence.channels.flatten(1) + coefficients[-1]).view(evidence.hidden.shape)
        if difference is None:
            return sum_at([logit.sigmoid_()], [evidence.scale], size)
        logit = sum_at([logit], [evidence.scale], size)
        logit += coefficients[count] * (difference + PIXEL).log_()
        return logit.sigmoid_()


_FIELDS = ("single", "checked")


def view_difference(disparity: Tensor, other: Tensor) -> Tensor:
    """The other view's disparity [H, W] where each pixel lands, less the pixel's own; outside, minus its own."""
    own = disparity[None, None]
    return warped_difference(own, other[None, None], own)[0, 0]
