from __future__ import annotations

import pytest
import torch
from torch import Tensor

from anynet import AnyNet, AnyNetConfig, load_checkpoint
from anynet.model.deploy import DeployedAnyNet
from anynet.model.residual_stage import DeployedCandidateStage, DeployedResidualStage


def images(height: int, width: int) -> tuple[Tensor, Tensor]:
    random = torch.Generator().manual_seed(height)
    left, right = (torch.randint(0, 256, (height, width, 3), dtype=torch.uint8, generator=random) for _ in range(2))
    return left, right


def test_a_stage_is_computed_when_it_is_asked_for(wild_model: AnyNet) -> None:
    network = DeployedAnyNet(wild_model)
    called: list[str] = []
    for name, part in network.named_children():
        part.register_forward_hook(lambda *_, name=name: called.append(name))
    for stage in network.residual_stages:
        stage.register_forward_hook(lambda *_: called.append("residual"))
    steps = network.stages(*images(32, 48))
    assert called == []
    for expected in (["first_stage"], ["residual"], ["residual"], ["refinement"]):
        next(steps)
        assert called == expected
        called.clear()


def test_forward_gives_the_first_stages(wild_model: AnyNet) -> None:
    network, pair = DeployedAnyNet(wild_model), images(37, 61)
    every = network(*pair)
    assert [d.shape for d in every] == [(37, 61)] * 4
    for stages in range(1, 5):
        for one, other in zip(network(*pair, stages=stages), every[:stages], strict=True):
            assert torch.equal(one, other)


def test_nothing_of_it_can_be_trained(wild_candidate_model: AnyNet) -> None:
    network = DeployedAnyNet(wild_candidate_model)
    assert not list(network.parameters())
    assert all(not buffer.requires_grad for buffer in network.buffers())


def test_it_does_not_change_with_the_model_it_was_made_of() -> None:
    model = AnyNet(AnyNetConfig()).eval()
    network, pair = DeployedAnyNet(model), images(32, 48)
    before = network(*pair)
    for norm in model.modules():
        if isinstance(norm, (torch.nn.BatchNorm2d, torch.nn.BatchNorm3d)):
            norm.reset_running_stats()
    assert all(torch.equal(one, other) for one, other in zip(network(*pair), before, strict=True))


@pytest.mark.parametrize(("weights", "kind"), [("paper", DeployedResidualStage), ("large", DeployedCandidateStage)])
def test_packaged_weights_are_deployed_part_by_part(weights: str, kind: type) -> None:
    network = DeployedAnyNet(load_checkpoint(weights))
    assert [type(stage) for stage in network.residual_stages] == [kind, kind]
    assert all(torch.isfinite(disparity).all() for disparity in network(*images(48, 80)))
