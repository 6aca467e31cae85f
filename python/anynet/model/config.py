"""What an AnyNet is made of, part by part."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from anynet.errors import AnyNetError
from anynet.model.bounds import as_tuples, check_flag, check_input_scale, check_range, check_whole

# Of ImageNet's RGB values in 0..1: what the network's inputs are normalized by.
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


@dataclass(frozen=True, kw_only=True)
class FeaturesConfig:
    """The U-Net. Its finest features lie at 1/4 of the images' resolution.

    Args:
        channels: at full and half resolution; doubled with each halving after that.
        blocks: below 1/4 resolution; each halves it.
        layers: convolutions per block.
        separate: not one U-Net, but a network per stage that shares nothing with the others (the paper's ablation,
            Fig. 7). Paper: no.
    """

    channels: int = 1
    blocks: int = 2
    layers: int = 2
    separate: bool = False

    def __post_init__(self) -> None:
        check_whole(self, "channels", 1, 64)
        check_whole(self, "blocks", 1, 5)
        check_whole(self, "layers", 1, 16)
        check_flag(self, "separate")

    @property
    def widths(self) -> list[int]:
        """Channels of the features at 1/4, 1/8, ... of the resolution."""
        return [self.channels * 2 ** (i + 1) for i in range(self.blocks + 1)]


@dataclass(frozen=True, kw_only=True)
class FirstStageConfig:
    """The full disparity, at the coarsest features.

    Args:
        range: first and last disparity to test, in pixels of these features.
        dims: of the cost network's convolutions. 2: the disparities are channels (`FlatFirstStage`), and the estimate
            has twice the features' resolution. Paper: 3.
        channels: of the cost network.
        layers: its convolutions between the first and the last one; of two dimensions, those after the hourglass.
        hourglass: halvings of the volume in the middle of the network, which see wide surfaces as a whole. Paper: 0.
        fine_costs: also compare features of twice the resolution, those of the U-Net's way down, in a cost volume that
            a strided convolution adds to its own: so it can tell things thinner than its pixels. Paper: no.
        excitation: the left features weigh the channels of the volume, pixel by pixel (Bangunharcana et al.,
            "Correlate-and-Excite", arXiv 2108.05773). Paper: no.
    """

    range: tuple[int, int] = (0, 11)
    dims: int = 3
    channels: int = 16
    layers: int = 4
    hourglass: int = 0
    fine_costs: bool = False
    excitation: bool = False

    def __post_init__(self) -> None:
        check_range(self, "range", self.range)
        check_whole(self, "dims", 2, 3)
        check_whole(self, "channels", 1, 256)
        check_whole(self, "layers", 0, 16)
        check_whole(self, "hourglass", 0, 4)
        check_flag(self, "fine_costs")
        check_flag(self, "excitation")
        if self.fine_costs and self.hourglass and not self.layers:  # a convolution takes them in
            raise AnyNetError("FirstStageConfig: expected layers above 0 with fine_costs and an hourglass, got 0")
        if self.dims == 2 and (self.fine_costs or not self.hourglass):
            raise AnyNetError(
                "FirstStageConfig: expected an hourglass and no fine_costs with 2 dims, which compare finer features "
                f"anyway, got hourglass {self.hourglass} and fine_costs {self.fine_costs}"
            )


@dataclass(frozen=True, kw_only=True)
class ResidualStagesConfig:
    """What the finer features add to the estimate.

    Args:
        ranges: per stage, first and last residual to test, in pixels of its features.
        channels: per stage, of its cost network.
        layers: convolutions of the 3-D network between the first and the last one.
        candidate_radius: 0, the paper's: residuals alone, judged in three dimensions. More: also the nearest and the
            farthest disparity at most so many pixels away, all judged in two dimensions (`CandidateStage`).
        reverse: test disparity `d - s` where `d + s` is counted, as the authors' released code and weights do.
        full_range: no residuals: each stage tests all disparities of the first stage's range, and forgets the estimate
            before (the paper's ablation, Fig. 7). `ranges` then say nothing. Paper: no.
    """

    ranges: tuple[tuple[int, int], ...] = ((-2, 2), (-2, 2))
    channels: tuple[int, ...] = (4, 4)
    layers: int = 4
    candidate_radius: int = 0
    reverse: bool = False
    full_range: bool = False

    def __post_init__(self) -> None:
        for name in ("ranges", "channels"):
            if not isinstance(getattr(self, name), tuple):
                raise AnyNetError(f"ResidualStagesConfig: expected {name}, one per stage, got {getattr(self, name)!r}")
        for ends in self.ranges:
            check_range(self, "ranges", ends)
        for channels in self.channels:
            if type(channels) is not int or not 1 <= channels <= 256:
                raise AnyNetError(f"ResidualStagesConfig: expected channels from 1 to 256, got {self.channels!r}")
        check_whole(self, "layers", 0, 16)
        check_whole(self, "candidate_radius", 0, 64)
        check_flag(self, "reverse")
        check_flag(self, "full_range")
        if bool(self.candidate_radius) + self.reverse + self.full_range > 1:
            raise AnyNetError(
                "ResidualStagesConfig: expected one of candidate_radius, reverse and full_range, got more"
            )


@dataclass(frozen=True, kw_only=True)
class RefinementConfig:
    """The last stage: spatial propagation at the finest features' resolution.

    Args:
        channels: of the propagation.
        directions: of its scans: 0 left to right, 1 right to left, 2 top to bottom, 3 bottom to top. Of several, the
            largest result counts, per pixel and channel (Liu et al., arXiv 1710.01020).
        fill_occlusions: what the estimate hides from the right camera takes the disparity of the background beside it
            first. Paper: no.
        warp_error: the guidance also sees the disparity, and how the right image, warped by it, differs from the left
            one. Paper: no.
        convex_upsampling: the result is enlarged to twice the resolution by learned weights (RAFT, arXiv 2003.12039),
            not bilinearly, and the guidance sees the left image at that resolution. Paper: no.
    """

    channels: int = 8
    directions: tuple[int, ...] = (0,)
    fill_occlusions: bool = False
    warp_error: bool = False
    convex_upsampling: bool = False

    def __post_init__(self) -> None:
        check_whole(self, "channels", 1, 64)
        directions = self.directions
        known = isinstance(directions, tuple) and all(type(d) is int and 0 <= d <= 3 for d in directions)
        if not known or not directions or len(set(directions)) < len(directions):
            raise AnyNetError(f"RefinementConfig: expected directions of distinct 0, 1, 2, 3, got {directions!r}")
        for name in ("fill_occlusions", "warp_error", "convex_upsampling"):
            check_flag(self, name)


@dataclass(frozen=True, kw_only=True)
class AnyNetConfig:
    """The shape of the network; the defaults are the paper's (Table I), with 43,269 parameters.

    There is one stage per resolution of the features, coarsest first, and a last one that refines.

    Args:
        input_scale: the images are resized by this factor first, from 1/16 to 4: above 1 everything is finer, for as
            many times the work squared. Resolutions below are those of the resized images; estimates have the size and
            the pixels of the images as they came.
        groups: the features' channels are compared in so many groups, each a channel of the cost volume (group-wise,
            Guo et al., arXiv 1903.04025). 0: not compared, but concatenated, C channels to volumes of 2C (the paper's
            ablation, Fig. 7). Paper: 1.
        features, first_stage, residual_stages, refinement: the parts.

    Raises:
        AnyNetError: if a value is of another type or out of its bounds, or the parts do not fit together.
    """

    input_scale: float = 1
    groups: int = 1
    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    first_stage: FirstStageConfig = field(default_factory=FirstStageConfig)
    residual_stages: ResidualStagesConfig = field(default_factory=ResidualStagesConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)

    def __post_init__(self) -> None:
        for name, kind in _PARTS.items():
            if not isinstance(getattr(self, name), kind):
                raise AnyNetError(
                    f"AnyNetConfig: expected {name} as {kind.__name__}, got {type(getattr(self, name)).__name__}"
                )
        check_input_scale(self, self.input_scale)
        check_whole(self, "groups", 0, 128)
        finest = self.features.widths[0]
        if self.groups and finest % self.groups:
            raise AnyNetError(
                f"AnyNetConfig: expected groups to divide the finest features' {finest} channels, got {self.groups}"
            )
        comparing = self.first_stage.fine_costs or self.first_stage.dims == 2 or self.residual_stages.candidate_radius
        if not self.groups and comparing:
            raise AnyNetError(
                "AnyNetConfig: expected groups above 0 with fine_costs, candidate_radius or a first stage of 2 dims, "
                "got 0"
            )
        for name in ("ranges", "channels"):
            count = len(getattr(self.residual_stages, name))
            if count != self.features.blocks:
                raise AnyNetError(
                    f"AnyNetConfig: expected residual_stages.{name} for each of {self.features.blocks} stages "
                    f"(features.blocks), got {count}"
                )

    @classmethod
    def from_dict(cls, options: Mapping[str, Any]) -> AnyNetConfig:
        """The configuration with these options, as JSON holds them: parts as objects, tuples as lists.

        Raises:
            AnyNetError: if an option is unknown, or its value is not possible.
        """
        config: AnyNetConfig = _from_dict(cls, "", options)
        return config

    def with_options(self, options: Mapping[str, Any]) -> AnyNetConfig:
        """With other values for some options, by their dotted names: {"features.channels": 4}."""
        values = asdict(self)
        for name, value in options.items():
            part, _, option = name.rpartition(".")
            target = values.get(part) if part else values
            if not isinstance(target, dict):
                raise AnyNetError(f"network: expected a part among {', '.join(_PARTS)}, got {part!r}")
            target[option] = value
        return self.from_dict(values)

    def with_input_scale(self, input_scale: float) -> AnyNetConfig:
        """For the same weights, another scale: above 1, the first stage reaches as far in the images' pixels.

        Below 1 it keeps its range: smaller images are for larger disparities, or for less time. So it does where the
        disparities are its channels.
        """
        other = replace(self, input_scale=input_scale)
        if self.first_stage.dims == 2:
            return other
        growth = max(other.input_scale, 1) / max(self.input_scale, 1)
        first, last = self.first_stage.range
        reach = math.floor(first * growth), math.ceil((last + 1) * growth) - 1
        return replace(other, first_stage=replace(self.first_stage, range=reach))

    @property
    def stages(self) -> int:
        """The number of estimates: one per resolution and the refined one."""
        return self.features.blocks + 2

    @property
    def reach(self) -> float:
        """Pixels of the images from which on the first stage finds no disparity."""
        return (self.first_stage.range[1] + 1) * (4 << self.features.blocks) / self.input_scale

    @property
    def enlargement(self) -> int:
        """1 or 2: what of `input_scale` the network does itself, without the enlarged images in memory."""
        return 2 if self.input_scale >= 2 else 1

    @property
    def zoom(self) -> float:
        """The rest of `input_scale`: images are resized by this factor before the network sees them."""
        return self.input_scale / self.enlargement

    @property
    def stride(self) -> int:
        """Pixels, before the enlargement, per pixel of the coarsest features; images are padded to multiples of it."""
        return (4 << self.features.blocks) // self.enlargement

    @property
    def finest(self) -> int:
        """Pixels, before the enlargement, per pixel of the finest features."""
        return 4 // self.enlargement


_PARTS: dict[str, type] = {
    "features": FeaturesConfig,
    "first_stage": FirstStageConfig,
    "residual_stages": ResidualStagesConfig,
    "refinement": RefinementConfig,
}


def _from_dict(kind: type, prefix: str, options: object) -> Any:
    if not isinstance(options, Mapping):
        raise AnyNetError(f"{kind.__name__}: expected options by name, got {options!r:.80}")
    known = [option.name for option in fields(kind)]
    values = {}
    for name, value in options.items():
        if name not in known:
            raise AnyNetError(f"network: expected options among {', '.join(known)}, got {prefix + str(name)[:80]!r}")
        part = _PARTS.get(name) if kind is AnyNetConfig else None
        values[name] = _from_dict(part, f"{name}.", value) if part is not None else as_tuples(value)
    return kind(**values)
