"""The paper's ablations (section IV-C, Fig. 7), as options of the network."""

from __future__ import annotations

import pytest
import torch
from networks import pair, wild

from anynet import AnyNet, AnyNetConfig, load_checkpoint, save_checkpoint
from anynet.errors import AnyNetError
from anynet.model.config import FeaturesConfig, FirstStageConfig, ResidualStagesConfig
from anynet.model.cost_volume import group_cost_volume
from anynet.model.deploy import DeployedAnyNet
from anynet.model.residual_stage import FullRangeStage

ABLATIONS = {
    "separate": AnyNetConfig(features=FeaturesConfig(separate=True)),
    "full_range": AnyNetConfig(residual_stages=ResidualStagesConfig(full_range=True)),
    "concatenated": AnyNetConfig(groups=0),
    "all": AnyNetConfig(
        groups=0, features=FeaturesConfig(separate=True), residual_stages=ResidualStagesConfig(full_range=True)
    ),
}


@pytest.mark.parametrize("name", ABLATIONS)
def test_it_trains_is_stored_and_deployed(tmp_path, name: str) -> None:
    config = ABLATIONS[name]
    model = AnyNet(config)
    estimates = model(*pair(48, 80, batch=2))
    assert [estimate.shape for estimate in estimates] == [(2, 1, 48, 80)] * 4
    torch.stack(estimates).sum().backward()
    assert all(parameter.grad is not None for parameter in model.parameters())
    model = wild(config)
    save_checkpoint(tmp_path / "w.safetensors", model)
    assert load_checkpoint(tmp_path / "w.safetensors").config == config
    random = torch.Generator().manual_seed(0)
    left, right = (torch.randint(0, 256, (37, 61, 3), dtype=torch.uint8, generator=random) for _ in range(2))
    mean, std = torch.tensor((0.485, 0.456, 0.406)), torch.tensor((0.229, 0.224, 0.225))
    normalized = [((image / 255 - mean) / std).permute(2, 0, 1)[None] for image in (left, right)]
    with torch.inference_mode():
        expected = model(*normalized)
        deployed = DeployedAnyNet(model)(left, right)
    for one, other in zip(deployed, expected, strict=True):
        assert other.std() > 0.1
        torch.testing.assert_close(one, other[0, 0], rtol=1e-3, atol=1e-3 * float(other.abs().max()))


def test_separate_networks_share_nothing() -> None:
    model = AnyNet(ABLATIONS["separate"]).eval()
    left, right = pair(32, 64)
    before = model(left, right)
    torch.nn.init.zeros_(model.features.encoders[0].first.weight)  # of the first stage
    after = model(left, right, stages=1)[0]
    assert not torch.allclose(before[0], after)
    features = [list(m.features.decode(m.features.encode(left))) for m in (model, AnyNet(ABLATIONS["separate"]).eval())]
    assert [level.shape[1:] for level in features[0]] == [(8, 2, 4), (4, 4, 8), (2, 8, 16)]
    torch.nn.init.zeros_(model.features.encoders[1].first.weight)
    changed = list(model.features.decode(model.features.encode(left)))
    assert [torch.equal(*levels) for levels in zip(changed, features[0], strict=True)] == [True, False, True]


def test_a_stage_of_full_range_finds_it_without_an_estimate() -> None:
    stages = AnyNet(ABLATIONS["full_range"]).residual_stages
    assert [stage.range for stage in stages if isinstance(stage, FullRangeStage)] == [(0, 23), (0, 47)]
    stage = stages[1].eval()
    features = torch.randn(2, 2, 8, 96)
    disparity = torch.rand(1, 1, 8, 96)
    torch.testing.assert_close(stage(features, disparity), stage(features, disparity + 100))
    # Costs themselves in place of what the network makes of them: the best match wins.
    features[1, :, :, :-37] = features[0, :, :, 37:]
    stage.network = torch.nn.Identity()
    torch.testing.assert_close(stage(1e4 * features, disparity)[0, 0, :, 40:59], torch.full((8, 19), 37.0))


def test_concatenated_features_by_hand() -> None:
    features = torch.tensor([[[[1.0, 2, 3]]], [[[5.0, 7, 9]]]])
    volume = group_cost_volume(features, None, 0, 1, 0)
    assert volume[0, :, :, 0].tolist() == [[[1, 2, 3], [1, 2, 3]], [[5, 7, 9], [0, 5, 7]]]
    half = torch.full((1, 1, 1, 3), 0.5)
    assert group_cost_volume(features, half, 0, 0, 0)[0, 1, 0, 0].tolist() == [2.5, 6, 8]


def test_sizes() -> None:
    """Beside the paper's 43,269 parameters."""
    sizes = {name: sum(p.numel() for p in AnyNet(config).parameters()) for name, config in ABLATIONS.items()}
    assert sizes["full_range"] == 43_269  # the same layers, on larger volumes
    assert sizes["concatenated"] - 43_269 == 15 * (27 * 16 + 2) + 7 * (27 * 4 + 2) + 3 * (27 * 4 + 2)
    assert 0.9 < sizes["separate"] / 43_269 < 1.1


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: AnyNetConfig(groups=0, first_stage=FirstStageConfig(fine_costs=True)),
            "groups above 0 with fine_costs",
        ),
        (lambda: ResidualStagesConfig(full_range=True, reverse=True), "expected one of candidate_radius, reverse and"),
        (lambda: FeaturesConfig(separate=1), "separate as true or false, got 1"),
    ],
)
def test_what_does_not_go_together(build, message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        build()
