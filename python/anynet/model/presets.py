"""The networks that have names."""

from __future__ import annotations

from dataclasses import replace

from anynet.model.config import (
    AnyNetConfig,
    FeaturesConfig,
    FirstStageConfig,
    RefinementConfig,
    ResidualStagesConfig,
)


def paper() -> AnyNetConfig:
    """The paper's (Table I): 43,269 parameters."""
    return AnyNetConfig()


def filled() -> AnyNetConfig:
    """Of the weights `paper`: the paper's, with occlusions filled before the refinement."""
    return AnyNetConfig(refinement=RefinementConfig(fill_occlusions=True))


def authors() -> AnyNetConfig:
    """Of the authors' released code and weights: the paper's, but that residuals are searched the other way round."""
    return AnyNetConfig(residual_stages=ResidualStagesConfig(reverse=True))


def default() -> AnyNetConfig:
    """Of the weights `default`: `large` with a first stage of two dimensions."""
    return replace(large(), first_stage=FirstStageConfig(dims=2, channels=32, layers=1, hourglass=3, excitation=True))


def large() -> AnyNetConfig:
    """Of the weights `large` and `kitti`, for images at their own size."""
    return AnyNetConfig(
        groups=4,
        features=FeaturesConfig(channels=4),
        first_stage=FirstStageConfig(hourglass=3, fine_costs=True, excitation=True),
        residual_stages=ResidualStagesConfig(ranges=((-3, 3), (-2, 2)), channels=(24, 16), candidate_radius=2),
        refinement=RefinementConfig(fill_occlusions=True, warp_error=True, convex_upsampling=True),
    )


NETWORKS = {"paper": paper, "authors": authors, "filled": filled, "default": default, "large": large}
