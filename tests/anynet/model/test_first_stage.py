from __future__ import annotations

from dataclasses import replace

import torch
from networks import pair
from torch import nn

from anynet import AnyNet
from anynet.model.config import FirstStageConfig
from anynet.model.layers import Hourglass, PreActivation


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
