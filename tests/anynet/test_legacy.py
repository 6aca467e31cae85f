from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from anynet import AnyNet, AnyNetConfig, legacy, load_checkpoint
from anynet.errors import AnyNetError
from anynet.model import presets

FLAT = {
    "input_scale": 1,
    "channels": 1,
    "blocks": 2,
    "layers": 2,
    "groups": 1,
    "cost_channels": [16, 4, 4],
    "cost_layers": 4,
    "hourglass": 0,
    "ranges": [[0, 11], [-2, 2], [-2, 2]],
    "spn_directions": [0],
    "spn_combine": "max",
    "reversed_residuals": False,
}


def test_the_papers_network_by_its_old_options() -> None:
    assert legacy.is_legacy(FLAT)
    assert AnyNetConfig.from_dict(legacy.upgrade_options(FLAT)) == presets.paper()
    assert AnyNetConfig.from_dict(legacy.upgrade_options({**FLAT, "reversed_residuals": True})) == presets.authors()
    assert AnyNetConfig.from_dict(legacy.upgrade_options({**FLAT, "spn_fill": True})) == presets.filled()


@pytest.mark.parametrize(
    ("option", "message"),
    [({"spn_combine": "mean"}, "got 'spn_combine'"), ({"depth": 3}, "got 'depth'"), ({"ranges": [[0]]}, "range as")],
)
def test_old_options_that_are_no_longer(option: dict[str, object], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        AnyNetConfig.from_dict(legacy.upgrade_options({**FLAT, **option}))


def test_a_file_of_that_version_loads(tmp_path: Path) -> None:
    model = AnyNet(presets.filled())
    old_places = {"first_stage.network": "cost_nets.0"} | {
        f"residual_stages.{stage}.network": f"cost_nets.{stage + 1}" for stage in range(2)
    }
    tensors = {}
    for name, tensor in model.state_dict().items():
        for place, old in old_places.items():
            name = name.replace(place, old)
        tensors[name] = tensor
    assert "cost_nets.2.5.norm.running_var" in tensors
    assert not any(name.startswith(("first_stage", "residual_stages")) for name in tensors)
    path = tmp_path / "old.safetensors"
    save_file(tensors, path, {"config": json.dumps({**FLAT, "spn_fill": True}), "metadata": "{}"})
    loaded = load_checkpoint(path)
    assert loaded.config == model.config
    for name, tensor in model.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor)
