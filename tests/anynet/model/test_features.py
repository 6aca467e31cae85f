from __future__ import annotations

import pytest
import torch

from anynet import AnyNet
from anynet.model.config import MEAN, STD
from anynet_ext import resize


@pytest.mark.parametrize("name", ["wild_model", "wild_large_model"])
@torch.no_grad()
def test_deployed_features_are_the_networks(request: pytest.FixtureRequest, name: str) -> None:
    model: AnyNet = request.getfixturevalue(name)
    config = model.config
    random = torch.Generator().manual_seed(0)
    left, right = (torch.randint(0, 256, (64, 96, 3), dtype=torch.uint8, generator=random) for _ in range(2))
    mean, std = torch.tensor(MEAN), torch.tensor(STD)
    images = ((torch.stack([left, right]) / 255 - mean) / std).permute(0, 3, 1, 2).contiguous()
    images = resize(images, (64 * config.enlargement, 96 * config.enlargement))
    deployed = model.features.deploy(config.enlargement, config.stride)
    expected = list(model.features.decode(model.features.encode(images)))
    features = list(deployed.decode(deployed.encode(left, right)))
    assert [f.shape[1] for f in features] == list(reversed(config.features.widths))
    for one, other in zip(features, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-3 * float(other.std()))
