from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from networks import picture, trained
from torch import nn

from anynet.model.chains import Hourglass, chain, deploy_chain, run, upsample_add
from anynet.model.layers import PreActivation


@pytest.mark.parametrize("activated", [False, True])
@torch.no_grad()
def test_a_chain_is_deployed(activated: bool) -> None:
    layers = trained(chain([3, 4, 6, 2]))
    assert isinstance(layers, nn.Sequential)
    x = picture(1, 3, 8, 20)
    seen = F.relu(layers[0].norm(x)) if activated else x  # type: ignore[operator]
    deployed = deploy_chain(list(layers), activated=activated)
    torch.testing.assert_close(run(deployed, seen), layers(x), rtol=1e-4, atol=1e-4)  # type: ignore[arg-type]


@pytest.mark.parametrize("levels", [1, 2])
@torch.no_grad()
def test_an_hourglass_with_excitation_is_deployed(levels: int) -> None:
    layers = trained(
        nn.Sequential(PreActivation(2, 4, dims=3), Hourglass(4, 8, levels, guide=3), PreActivation(4, 1, dims=3))
    )
    assert isinstance(layers, nn.Sequential)
    x, guide = picture(1, 2, 6, 9, 11), picture(1, 3, 9, 11)
    expected = run(layers, x, guide)
    assert not torch.allclose(expected, run(layers, x, 0 * guide), atol=1e-2)
    deployed = deploy_chain(list(layers))
    torch.testing.assert_close(run(deployed, x, guide), expected, rtol=1e-4, atol=1e-4)  # type: ignore[arg-type]


def test_upsample_add_is_trilinear() -> None:
    x, coarse = picture(2, 3, 6, 10, 14), picture(2, 3, 3, 5, 7)
    torch.testing.assert_close(upsample_add(x, coarse), x + F.interpolate(coarse, scale_factor=2, mode="trilinear"))
