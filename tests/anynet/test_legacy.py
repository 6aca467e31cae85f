from __future__ import annotations

import json
from pathlib import Path

import pytest
from safetensors import safe_open

from anynet import AnyNet, AnyNetConfig, legacy
from anynet.checkpoint import PACKAGED
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


@pytest.mark.parametrize("file", sorted(PACKAGED.glob("*.safetensors")), ids=lambda file: file.stem)
def test_every_tensor_of_the_packaged_weights_has_its_place(file: Path) -> None:
    with safe_open(file, "pt") as stored:
        options = json.loads(stored.metadata()["config"])
        shapes = {name: tuple(stored.get_slice(name).get_shape()) for name in stored.keys()}  # noqa: SIM118
    if not legacy.is_legacy(options):
        pytest.skip(f"{file.name} has today's names")
    config = AnyNetConfig.from_dict(legacy.upgrade_options(options))
    assert config.with_input_scale(1) == {"paper": presets.filled()}.get(file.stem, presets.large())
    own = {name: tuple(tensor.shape) for name, tensor in AnyNet(config).state_dict().items()}
    assert {legacy.upgrade_name(name): shape for name, shape in shapes.items()} == own
