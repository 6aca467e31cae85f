"""A step of training through `torch.compile`, and in bfloat16."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import torch
from planes import begun
from torch import Tensor

from anynet import AnyNet, AnyNetConfig
from anynet.model import presets
from anynet.model.config import FirstStageConfig

# Of more channels than our own operators take, which compute in float32 under autocast.
WIDE = AnyNetConfig(first_stage=FirstStageConfig(channels=72, layers=1))


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


@pytest.mark.slow
@pytest.mark.parametrize("amp", [False, True])
def test_a_compiled_step_of_a_run_equals_a_plain_one(tmp_path: Path, amp: bool) -> None:
    plain, batch = begun(tmp_path, amp=amp, network=WIDE)
    compiled, _ = begun(tmp_path, amp=amp, network=WIDE)
    compiled.parallel = torch.compile(compiled.model, backend="aot_eager")
    before = copy.deepcopy(plain.model.state_dict())
    for _ in range(2):
        expected, found = plain._update(batch), compiled._update(batch)
        torch.testing.assert_close(found, expected, rtol=2e-2 if amp else 1e-4, atol=0)
    moved = [name for name, value in plain.model.state_dict().items() if not torch.equal(value, before[name])]
    assert len(moved) > len(list(plain.model.parameters()))  # and the statistics


def test_a_step_in_bfloat16_is_near_one_in_float32(tmp_path: Path) -> None:
    plain, batch = begun(tmp_path, network=WIDE)
    half, _ = begun(tmp_path, network=WIDE, amp=True)
    dtypes = set()
    for module in half.model.modules():
        module.register_forward_hook(lambda _, __, out: dtypes.add(getattr(out, "dtype", None)))
    expected, found = plain._update(batch), half._update(batch)
    assert torch.bfloat16 in dtypes
    assert all(parameter.dtype == torch.float32 for parameter in half.model.parameters())
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, expected, rtol=5e-2, atol=0)
    assert not torch.equal(found, expected)
