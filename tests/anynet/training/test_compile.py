"""A step of training through `torch.compile`."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor

from anynet import AnyNet
from anynet.model import presets


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["aot_eager", "inductor"])
def test_a_compiled_step_equals_a_plain_one(backend: str) -> None:
    torch.manual_seed(0)
    model = AnyNet(presets.filled().with_options({"first_stage.channels": 4})).double()
    left, right = torch.rand(2, 2, 3, 48, 64, dtype=torch.float64)
    truth = torch.rand(2, 1, 48, 64, dtype=torch.float64) * 10

    def step(network: AnyNet) -> Tensor:
        loss = torch.stack([(estimate - truth).abs().mean() for estimate in network(left, right)]).sum()
        loss.backward()  # type: ignore[no-untyped-call]
        return loss.detach()

    other = copy.deepcopy(model)
    expected = step(model)
    torch.testing.assert_close(step(torch.compile(other, backend=backend)), expected)  # type: ignore[arg-type]
    for (name, one), two in zip(model.named_parameters(), other.parameters(), strict=True):
        torch.testing.assert_close(two.grad, one.grad, msg=name)
    for (name, one), two in zip(model.named_buffers(), other.buffers(), strict=True):
        torch.testing.assert_close(two, one, msg=name)
