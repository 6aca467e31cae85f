from __future__ import annotations

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode, flop_registry

import anynet_ext
from anynet import AnyNet, Predictor


def flops(function) -> int:  # type: ignore[no-untyped-def]
    with FlopCounterMode(display=False) as counter:
        function()
    return counter.get_total_flops()


def test_every_operator_has_a_formula() -> None:
    names = {n.split("::")[1].split(".")[0] for n in torch._C._dispatch_get_all_op_names() if n.startswith("anynet::")}
    assert {"warp", "warp_backward", "stem"} <= names
    assert {name for name in names if getattr(torch.ops.anynet, name) not in flop_registry} == set()


def test_a_convolution_counts_as_pytorchs_does() -> None:
    x, weight = torch.rand(2, 3, 8, 9, requires_grad=True), torch.rand(5, 3, 3, 3, requires_grad=True)
    for stride in (1, 2):
        ours = flops(lambda stride=stride: anynet_ext.conv3x3(x, weight, stride=stride).sum().backward())
        theirs = flops(lambda stride=stride: torch.conv2d(x, weight, stride=stride, padding=1).sum().backward())
        assert ours == theirs


@pytest.mark.parametrize("disparity", [None, torch.zeros(2, 1, 8, 9)])
def test_a_cost_volume(disparity: torch.Tensor | None) -> None:
    left, right = torch.rand(2, 2, 3, 8, 9).requires_grad_()
    per_value = 3 * (3 if disparity is None else 6)
    assert flops(lambda: anynet_ext.cost_volume(left, right, disparity, 0, 4)) == 2 * 5 * 72 * per_value
    assert flops(lambda: anynet_ext.cost_volume(left, right, disparity, 0, 4).sum().backward()) == 3 * 720 * per_value


def test_the_papers_network_needs_what_its_layers_do() -> None:
    images = torch.zeros(2, 1, 3, 64, 128)
    with torch.no_grad():
        assert 0.02e9 < flops(lambda: AnyNet()(*images)) < 0.06e9


def test_the_deployed_network_is_counted() -> None:
    network = Predictor("paper")._network
    images = torch.zeros(2, 64, 128, 3, dtype=torch.uint8)
    assert 0.02e9 < flops(lambda: network(*images)) < 0.06e9
