from __future__ import annotations

import math

import pytest
import torch
from torch import nn

from anynet import AnyNet, AnyNetConfig
from anynet.network import Convolution


def wild(config: AnyNetConfig | None = None, seed: int = 8) -> AnyNet:
    """Random weights of larger scales than training begins with: disparities from -40 to 200, mostly positive."""
    model = AnyNet(config)
    torch.manual_seed(seed)
    for module in model.modules():
        if isinstance(module, Convolution):
            nn.init.normal_(module.weight, std=math.sqrt(2 / module.weight[:, 0].numel()))
    return model.eval()


@pytest.fixture(scope="session")
def wild_model() -> AnyNet:
    return wild()


@pytest.fixture(scope="session")
def wild_large_model() -> AnyNet:
    """Not of the paper's shape: more of everything, on enlarged images."""
    ranges = (0, 11), (-4, 4), (-3, 3), (-2, 2)
    # Some seeds' gates multiply rounding by thousands: the same network in double precision is then as far off.
    return wild(
        AnyNetConfig(
            input_scale=2,
            channels=4,
            blocks=3,
            groups=4,
            hourglass=2,
            finer_costs=True,
            guided=True,
            cost_channels=(16, 16, 8, 4),
            ranges=ranges,
            spn_directions=(1, 0),
            spn_combine="mean",
            spn_mismatch=True,
            spn_upsampling=True,
        ),
        seed=9,
    )


@pytest.fixture(scope="session")
def wild_updating_model() -> AnyNet:
    return wild(AnyNetConfig(channels=2, groups=2, neighbours=2, spn_mismatch=True))
