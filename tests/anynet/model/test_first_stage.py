from __future__ import annotations

from dataclasses import replace
from itertools import islice

import pytest
import torch
from networks import pair, wild
from torch import nn

from anynet import AnyNet, AnyNetConfig
from anynet.model.anynet import normalize
from anynet.model.chains import Hourglass
from anynet.model.config import FeaturesConfig, FirstStageConfig, ResidualStagesConfig
from anynet.model.deploy import DeployedAnyNet
from anynet.model.first_stage import FlatFirstStage
from anynet.model.layers import Convolution, PreActivation


def test_fine_costs_and_excitation_begin_as_the_identity(wild_model: AnyNet) -> None:
    """And then they reach the first estimate: the fine costs from both images, the excitation from the left one."""
    options = replace(wild_model.config, first_stage=FirstStageConfig(hourglass=1, fine_costs=True, excitation=True))
    torch.manual_seed(0)
    model = AnyNet(options).eval()
    for module in model.modules():
        if isinstance(module, Hourglass):
            nn.init.normal_(module.up.conv.weight)
    plain = AnyNet(replace(options, first_stage=FirstStageConfig(hourglass=1))).eval()
    plain.load_state_dict({name: value for name, value in model.state_dict().items() if name in plain.state_dict()})
    images = pair(48, 80)
    with torch.no_grad():
        expected = plain(*images, 1)[0]
        assert torch.equal(model(*images, 1)[0], expected)
        excitations = [
            module.excitation for module in model.modules() if isinstance(module, PreActivation) and module.excitation
        ]
        assert len(excitations) == 3  # two, and one in the hourglass
        assert model.first_stage.fine_costs is not None
        for layer in (*excitations, model.first_stage.fine_costs.conv):
            nn.init.normal_(layer.weight)
            assert not torch.equal(model(*images, 1)[0], expected)
            nn.init.zeros_(layer.weight)


FLAT = FirstStageConfig(dims=2, channels=8, layers=1, hourglass=2, excitation=True)


@pytest.mark.parametrize("size", [(48, 80), (37, 107)])
@pytest.mark.parametrize("blocks", [1, 2])
@pytest.mark.parametrize("layers", [0, 1])
def test_the_flat_stage_deployed_is_the_module(size: tuple[int, int], blocks: int, layers: int) -> None:
    config = AnyNetConfig(
        features=FeaturesConfig(channels=2, blocks=blocks),
        first_stage=replace(FLAT, layers=layers),
        residual_stages=ResidualStagesConfig(ranges=((-2, 2),) * blocks, channels=(4,) * blocks, candidate_radius=1),
    )
    model = wild(config)
    images = [torch.randint(0, 256, (*size, 3), generator=torch.Generator().manual_seed(i)) for i in range(2)]
    images = [image.to(torch.uint8) for image in images]
    with torch.no_grad():
        expected = model.double()(*(normalize(image.permute(2, 0, 1)[None].double()) for image in images))
    assert len(expected) == blocks + 2
    for estimate, result in zip(expected, DeployedAnyNet(model.float())(*images), strict=True):
        assert estimate.std() > 1
        assert torch.allclose(estimate[0, 0].float(), result, atol=2e-3)


def test_the_flat_stage_has_twice_the_resolution_and_reach_in_pixels() -> None:
    """The cost of every disparity is a channel: the one of the true shift wins, half of a coarse pixel apart."""
    config = AnyNetConfig(first_stage=replace(FLAT, excitation=False))
    stage = FlatFirstStage(config).eval()
    features, finer = torch.zeros(2, 8, 6, 20), torch.zeros(2, 4, 12, 40)
    with torch.no_grad():
        assert stage(features, finer).shape == (1, 1, 12, 40)
    assert stage.end[-1].conv.weight.shape[0] == 24
    network = DeployedAnyNet(AnyNet(config).eval())
    left = torch.zeros(64, 96, 3, dtype=torch.uint8)
    first, second = islice(network.stages(left, left), 2)
    assert first.scales == [8]
    assert first.maps[0].shape == (8, 12)
    assert first.spread is not None
    assert first.spread[1] == 8
    assert second.scales == [8]  # its residual has the same resolution, and is added


def test_both_images_and_both_resolutions_reach_the_flat_stage() -> None:
    stage = FlatFirstStage(AnyNetConfig(first_stage=FLAT)).eval()
    for layer in stage.modules():
        if isinstance(layer, Convolution):
            nn.init.normal_(layer.weight, std=0.1)
    inputs = [torch.randn(2, 8, 6, 20, requires_grad=True), torch.randn(2, 4, 12, 40, requires_grad=True)]
    for gradient in torch.autograd.grad(stage(*inputs).sum(), inputs):
        assert (gradient.flatten(1).abs().amax(1) > 0).all()
