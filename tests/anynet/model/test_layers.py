from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anynet.model.layers import (
    Convolution,
    Hourglass,
    PreActivation,
    affine_of,
    chain,
    deploy_chain,
    few_channels,
    norm_relu,
    run,
    upsample_add,
)


def trained(module: nn.Module) -> nn.Module:
    """With batch norms that do something, and weights that begin as 0 random."""
    torch.manual_seed(1)
    for part in module.modules():
        if isinstance(part, (nn.BatchNorm2d, nn.BatchNorm3d)):
            for tensor in (part.weight, part.bias, part.running_mean):
                nn.init.normal_(tensor)  # type: ignore[arg-type]
            nn.init.uniform_(part.running_var, 0.5, 2)  # type: ignore[arg-type]
        elif isinstance(part, Convolution):
            nn.init.normal_(part.weight, std=0.3)
    return module.eval()


def picture(*shape: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(sum(shape)))


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("channels", [(3, 5), (5, 40), (70, 4)])
@pytest.mark.parametrize("stride", [1, 2])
@torch.no_grad()
def test_a_convolution_folds_what_surrounds_it(dims: int, channels: tuple[int, int], stride: int) -> None:
    """Whether our operator computes it or PyTorch's."""
    inputs, outputs = channels
    conv = trained(Convolution(inputs, outputs, dims=dims, stride=stride, bias=True))
    assert isinstance(conv, Convolution)
    assert few_channels(conv.weight) == (channels == (3, 5))
    before, after = (trained((nn.BatchNorm2d, nn.BatchNorm3d)[dims - 2](c)) for c in channels)
    x = picture(1, inputs, *[4, 7, 9][3 - dims :])
    expected = F.relu(after(conv(F.relu(before(x)))))
    deployed = conv.deploy(affine_of(before), affine_of(after), relu_out=True)
    torch.testing.assert_close(deployed(x), expected, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(conv.deploy()(x), conv(x), rtol=1e-4, atol=1e-4)


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


@pytest.mark.parametrize("dims", [2, 3])
def test_a_norm_tracks_its_statistics_as_pytorchs_does(dims: int) -> None:
    kind = (nn.BatchNorm2d, nn.BatchNorm3d)[dims - 2]
    ours, theirs = kind(4), kind(4)
    x = 3 + 2 * picture(2, 4, *[3, 8, 10][3 - dims :])
    torch.testing.assert_close(norm_relu(x, ours), F.relu(theirs(x)), rtol=1e-4, atol=1e-5)
    for one, other in zip(ours.buffers(), theirs.buffers(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)
