from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from networks import picture, trained
from torch import nn

from anynet.model.layers import Convolution, affine_of, few_channels, norm_relu


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("channels", [(3, 5), (5, 40), (5, 70), (70, 4)])
@pytest.mark.parametrize("stride", [1, 2])
@torch.no_grad()
def test_a_convolution_folds_what_surrounds_it(dims: int, channels: tuple[int, int], stride: int) -> None:
    """Whether our operator computes it or PyTorch's."""
    inputs, outputs = channels
    conv = trained(Convolution(inputs, outputs, dims=dims, stride=stride, bias=True))
    assert isinstance(conv, Convolution)
    assert few_channels(conv.weight) == (max(channels) <= 64)
    before, after = (trained((nn.BatchNorm2d, nn.BatchNorm3d)[dims - 2](c)) for c in channels)
    x = picture(1, inputs, *[4, 7, 9][3 - dims :])
    expected = F.relu(after(conv(F.relu(before(x)))))
    deployed = conv.deploy(affine_of(before), affine_of(after), relu_out=True)
    torch.testing.assert_close(deployed(x), expected, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(conv.deploy()(x), conv(x), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("channels", "ours"), [((5, 32), True), ((5, 33), False), ((20, 5), True), ((20, 20), False)])
def test_a_gpu_has_limits_of_its_own(channels: tuple[int, int], ours: bool) -> None:
    conv = Convolution(*channels).deploy()
    assert conv.plain
    conv.for_gpu(torch.float32)
    assert conv.plain == ours


@pytest.mark.parametrize("dims", [2, 3])
def test_a_norm_tracks_its_statistics_as_pytorchs_does(dims: int) -> None:
    kind = (nn.BatchNorm2d, nn.BatchNorm3d)[dims - 2]
    ours, theirs = kind(4), kind(4)
    x = 3 + 2 * picture(2, 4, *[3, 8, 10][3 - dims :])
    torch.testing.assert_close(norm_relu(x, ours), F.relu(theirs(x)), rtol=1e-4, atol=1e-5)
    for one, other in zip(ours.buffers(), theirs.buffers(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)
