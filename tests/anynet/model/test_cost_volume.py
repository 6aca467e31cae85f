from __future__ import annotations

import torch
from torch import nn

from anynet.model.chains import Hourglass
from anynet.model.cost_volume import cost_network


def test_the_hourglass_begins_as_the_identity_and_reaches_far() -> None:
    """Of the cost network of the first stage, by its response to one cell of the volume."""
    torch.manual_seed(0)
    plain = cost_network(1, 4, layers=4).eval()
    deep = cost_network(1, 4, layers=4, hourglass=2).eval()
    hourglass = next(i for i, module in enumerate(deep) if isinstance(module, Hourglass))
    assert hourglass == len(plain) // 2
    for i, layer in enumerate(plain):
        deep[i if i < hourglass else i + 1].load_state_dict(layer.state_dict())
    empty, one = torch.zeros(2, 1, 1, 12, 5, 64)
    one[0, 0, 6, 2, 8] = 1
    with torch.no_grad():
        torch.testing.assert_close(deep(one), plain(one))

        def reach(net: nn.Module) -> int:
            return int(torch.where(net(one) != net(empty))[4].max()) - 8

        assert reach(plain) == len(plain)
        for module in deep.modules():
            if isinstance(module, Hourglass):
                nn.init.normal_(module.up.conv.weight)
        assert reach(deep) > 20
