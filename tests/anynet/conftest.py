from __future__ import annotations

import pytest
from networks import wild

from anynet import AnyNet, AnyNetConfig
from anynet.model.config import FeaturesConfig, FirstStageConfig, RefinementConfig, ResidualStagesConfig


@pytest.fixture(scope="session")
def wild_model() -> AnyNet:
    return wild()


@pytest.fixture(scope="session")
def wild_large_model() -> AnyNet:
    """Not of the paper's shape: more of everything, on enlarged images."""
    # Some seeds' gates multiply rounding by thousands: the same network in double precision is then as far off.
    return wild(
        AnyNetConfig(
            input_scale=2,
            groups=4,
            features=FeaturesConfig(channels=4, blocks=3),
            first_stage=FirstStageConfig(hourglass=2, fine_costs=True, excitation=True),
            residual_stages=ResidualStagesConfig(ranges=((-4, 4), (-3, 3), (-2, 2)), channels=(16, 8, 4)),
            refinement=RefinementConfig(directions=(1, 0), warp_error=True, convex_upsampling=True),
        ),
        seed=9,
    )


@pytest.fixture(scope="session")
def wild_candidate_model() -> AnyNet:
    return wild(
        AnyNetConfig(
            groups=2,
            features=FeaturesConfig(channels=2),
            residual_stages=ResidualStagesConfig(candidate_radius=2),
            refinement=RefinementConfig(warp_error=True),
        ),
        seed=10,
    )
