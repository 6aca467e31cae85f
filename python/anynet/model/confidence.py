"""How far to trust an estimate: a logistic regression on what the network has at hand (docs/confidence.md)."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from anynet.errors import AnyNetError, one_line
from anynet.io.files import read_text, write_atomically
from anynet.model.deploy import DeployedAnyNet, StageResult, block_means, sum_at
from anynet.model.graphs import GraphedAnyNet
from anynet.model.refinement import warped_difference
from anynet_ext import reference

_ops = torch.ops.anynet

PIXEL = 0.25  # added to lengths before their logarithm; what is less does not matter
SHADE = 0.02  # the same of differences between normalized colors
PLACE = 4  # channels that say where things are; how sure a disparity is, the others say
BLOCKS = (4, 16)  # sides of what counts as a pixel's surroundings, in pixels of the evidence
HIDDEN = 1.0  # pixels by which something lies behind another, or outside, before it counts as occluded


@dataclass(frozen=True)
class Evidence:
    """At half the resolution of the finest features, one pixel per `scale` of the images.

    Attributes:
        channels: [F, h, w], the logarithms of: the disparity; how far it varies around the pixel; by how much it lies
            behind something nearer in the right image, and outside of it; the standard deviations of all stages'
            softmax, the last one first; what each stage changed; the warp error; the texture.
        hidden: [h, w], pixels by which it lies behind something nearer, or outside the right image.
        scale: pixels of the images per pixel.
    """

    channels: Tensor
    hidden: Tensor
    scale: int


def evidence_count(stage: int, last: bool) -> int:
    """Channels of the evidence on a stage, from 1; the last one has no softmax of its own."""
    return PLACE + (stage - last) + (stage - 1) + 2


def coefficient_count(stage: int, last: bool) -> int:
    """Of the evidence on a stage, its products and its means over the blocks."""
    return sum(_counts(evidence_count(stage, last)))


def _counts(channels: int) -> list[int]:
    """Coefficients of so many channels, their products, and their means over each kind of block."""
    return [channels, channels * (channels + 1) // 2, *[channels - PLACE] * len(BLOCKS)]


def gather_evidence(
    network: DeployedAnyNet | GraphedAnyNet, result: StageResult, left: Tensor, right: Tensor, pixel: float = 1.0
) -> Evidence:
    """The evidence on a stage's result.

    Args:
        left, right: the images that the network was given, [H, W, 3] uint8.
        pixel: the unit for lengths, over the pixel of these images.
    """
    refinement, finest = network.refinement, network.config.finest
    scale = 2 * finest
    fine_size = [n * result.scales[0] // finest for n in result.maps[0].shape]
    size = [(n + 1) // 2 for n in fine_size]
    steps = [result]
    while (step := steps[-1].before) is not None:
        steps.append(step)
    before = [step.at(scale, size) for step in steps[1:]]
    fine = result.at(finest, fine_size)
    disparity = block_means(fine, 2)
    deviations = [
        sum_at([distribution.deviation(max(1, scale // stride))], [max(1, stride // scale)], size, [stride])
        for distribution, stride in (step.spread for step in steps if step.spread is not None)
    ]
    outside, behind = (scale * distance for distance in reference.occlusion_distances(disparity / scale))
    outside.clamp_(min=0)
    mean, std = refinement.mean, refinement.std
    guide = _ops.refinement_guide.default(left, right, fine[None, None], mean, std, finest, 1)[0]
    seen, error = guide[:3], guide[3:6].abs().mean(0)
    texture = F.pad((seen[:, :, 2:] - seen[:, :, :-2]).abs().mean(0), (1, 1))
    lengths = [disparity.clamp(min=0), _variation(disparity), behind, outside, *deviations]
    lengths += [(later - earlier).abs() for later, earlier in pairwise([disparity, *before])]
    channels = torch.stack([*lengths, *block_means(torch.stack([error, texture]), 2)])
    channels[: len(lengths)].mul_(pixel).add_(PIXEL)
    channels[len(lengths) :].add_(SHADE)
    return Evidence(channels.log_(), torch.maximum(behind, outside) * pixel, scale)


def products(channels: Tensor) -> Tensor:
    """[F (F + 1) / 2, h, w]: of the channels [F, h, w], each with itself and all after it."""
    first, second = torch.triu_indices(len(channels), len(channels), device=channels.device)
    return channels[first] * channels[second]


def surroundings(channels: Tensor) -> list[tuple[Tensor, int]]:
    """Of channels [F, h, w] all but the first `PLACE`, averaged over blocks; each with its block's side."""
    parts = []
    means, before = channels[PLACE:], 1
    for side in BLOCKS:
        means, before = block_means(means, side // before), side
        parts.append((means, side))
    return parts


def _variation(disparity: Tensor) -> Tensor:
    """Largest less smallest value of 5 x 5 pixels."""
    values = F.pad(torch.stack([disparity, -disparity]), (2, 2, 2, 2), value=-math.inf)
    for axis in (1, 2):  # by shifted copies: five times as fast as a pooling
        size = values.shape[axis] - 4
        values = reduce(torch.maximum, (values.narrow(axis, i, size) for i in range(5)))
    return values.sum(0)


@dataclass(frozen=True)
class ConfidenceModel:
    """The regressions' coefficients, stage by stage.

    Attributes:
        single: per stage, of the evidence, of its products, of its means over the blocks, and the constant.
        checked: the same, with that of the difference to the right view's disparity before the constant.
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
            expected = [coefficient_count(stage, stage == stages) + more for stage in range(1, stages + 1)]
            got = [row.numel() if row.dim() == 1 and bool(row.isfinite().all()) else 0 for row in rows]
            if got != expected:
                raise AnyNetError(f"{path}: expected {expected} finite coefficients, got {got}")
        return cls(*models)

    def to(self, device: torch.device) -> ConfidenceModel:
        return ConfidenceModel(*([row.to(device) for row in getattr(self, name)] for name in _FIELDS))

    def write(self, path: Path) -> None:
        """As JSON.

        Raises:
            AnyNetError: if not all coefficients are finite, or the file cannot be written.
        """
        if not all(row.float().isfinite().all() for name in _FIELDS for row in getattr(self, name)):
            raise AnyNetError(f"cannot write {path}: expected finite coefficients, got NaN or infinity")
        content = {name: [[round(float(v), 5) for v in row] for row in getattr(self, name)] for name in _FIELDS}
        write_atomically(path, (json.dumps(content) + "\n").encode())

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
        channels, means = evidence.channels.flatten(1), surroundings(evidence.channels)
        count = len(channels)
        counts = _counts(count)
        linear, quadratic, *around = torch.split(coefficients[: sum(counts)], counts)
        form = channels.new_zeros(count, count)
        first, second = torch.triu_indices(count, count, device=form.device)
        form[first, second] = quadratic
        own = linear @ channels + (channels * (form @ channels)).sum(0) + coefficients[-1]
        maps = [own.view(evidence.hidden.shape)]
        maps += [
            (weights @ part.flatten(1)).view(part.shape[1:]) for weights, (part, _) in zip(around, means, strict=True)
        ]
        logit = sum_at(maps, [1, *BLOCKS], evidence.hidden.shape)
        if difference is None:
            return sum_at([logit.sigmoid_()], [evidence.scale], size)
        logit = sum_at([logit], [evidence.scale], size)
        logit += coefficients[-2] * (difference + PIXEL).log_()
        return logit.sigmoid_()


_FIELDS = ("single", "checked")


def view_difference(disparity: Tensor, other: Tensor) -> Tensor:
    """The other view's disparity [H, W] where each pixel lands, less the pixel's own; outside, minus its own."""
    own = disparity[None, None]
    return warped_difference(own, other[None, None], own)[0, 0]
