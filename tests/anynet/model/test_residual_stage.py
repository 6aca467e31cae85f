from __future__ import annotations

import torch
from networks import pair
from torch import nn

from anynet import AnyNet, AnyNetConfig
from anynet.model.config import FeaturesConfig, ResidualStagesConfig
from anynet.model.layers import Convolution
from anynet.model.residual_stage import CandidateStage


def stage(ends: tuple[int, int], radius: int) -> CandidateStage:
    """On features of 4 channels, in 2 groups."""
    config = AnyNetConfig(
        groups=2,
        features=FeaturesConfig(channels=2, blocks=1),
        residual_stages=ResidualStagesConfig(ranges=(ends,), channels=(8,), candidate_radius=radius),
    )
    return CandidateStage(config, 0).eval()


def test_a_candidate_stage_takes_what_costs_least() -> None:
    """A residual of its own estimate, or what a neighbor says, however far away that is."""
    update = stage((-1, 2), radius=1)
    features = torch.randn(2, 4, 3, 9, generator=torch.Generator().manual_seed(0))
    disparity = torch.full((1, 1, 3, 9), 7.0)
    disparity[..., 1, 4] = 50
    disparity[..., 1, 7] = 1

    def chosen(k: int) -> torch.Tensor:
        costs = torch.full((1, 6, 3, 9), 100.0)
        costs[:, k] = 0
        update.network = nn.Sequential(nn.Identity())
        update.network.register_forward_hook(lambda *_: costs)
        return update(features, disparity)

    for k in range(4):
        torch.testing.assert_close(chosen(k), disparity + k - 1)
    near, far = disparity.clone(), disparity.clone()
    near[..., 3:6], near[..., 1, 7] = 50, 7
    far[..., 6:9], far[..., 1, 4] = 1, 7
    torch.testing.assert_close(chosen(4), near)
    torch.testing.assert_close(chosen(5), far)


def test_a_candidate_stage_sees_what_its_neighbors_disparities_cost() -> None:
    """A strip 10 pixels nearer, which the estimate has in its middle column only: beside that, the largest fits."""
    update = stage((-1, 1), radius=2)
    right = torch.randn(1, 4, 5, 40, generator=torch.Generator().manual_seed(0))
    left = right.roll(2, 3)
    left[..., 18:23] = right.roll(12, 3)[..., 18:23]
    disparity = torch.full((1, 1, 5, 40), 2.0)
    disparity[..., 20] = 12
    seen = []
    update.network.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    with torch.no_grad():
        update(torch.cat([left, right]), disparity)
    (picture,) = seen
    assert picture.shape == (1, 2 * 5 + 4 + 2, 5, 40)
    own, near, far = (picture[:, channels].sum(1) for channels in ([1, 4], [6, 7], [8, 9]))  # both groups of each
    assert (near[..., 18:23] == 0).all()
    assert (own[..., 20] == 0).all()
    assert (own[..., [18, 19, 21, 22]] > 0.1).all()
    assert (far[..., 24:30] == 0).all()
    assert torch.equal(picture[:, 10:14], left)
    assert (picture[:, 14, :, 18:23] == torch.tensor([10.0, 10, 0, 10, 10])).all()
    assert (picture[:, 15, :, 18:23] == torch.tensor([0.0, 0, -10, 0, 0])).all()


def test_reversed_residuals_are_the_other_direction_of_search() -> None:
    """With weights that are symmetric along the tested disparities, the two conventions differ only in sign."""
    torch.manual_seed(0)
    plain, reverse = AnyNet().eval(), AnyNet(AnyNetConfig(residual_stages=ResidualStagesConfig(reverse=True))).eval()
    for module in plain.residual_stages.modules():
        if isinstance(module, Convolution):
            module.weight.data = (module.weight.data + module.weight.data.flip(2)) / 2
    reverse.load_state_dict(plain.state_dict())
    with torch.no_grad():
        first, second = plain(*pair(64, 128), stages=2)
        _, reversed_second = reverse(*pair(64, 128), stages=2)
    assert (second - first).abs().max() > 0.05
    torch.testing.assert_close(reversed_second - first, first - second, rtol=1e-4, atol=1e-3)
