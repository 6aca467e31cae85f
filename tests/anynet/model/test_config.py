from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest

from anynet import AnyNetConfig
from anynet.errors import AnyNetError
from anynet.model import presets
from anynet.model.config import FirstStageConfig


@pytest.mark.parametrize("name", presets.NETWORKS)
def test_a_configuration_survives_json(name: str) -> None:
    config = presets.NETWORKS[name]()
    assert AnyNetConfig.from_dict(json.loads(json.dumps(asdict(config)))) == config


def test_options_by_dotted_names() -> None:
    config = AnyNetConfig().with_options({"features.channels": 4, "groups": 2, "first_stage.range": [0, 5]})
    assert config.features.channels == 4
    assert config.groups == 2
    assert config.first_stage == FirstStageConfig(range=(0, 5))
    assert config.residual_stages == AnyNetConfig().residual_stages


@pytest.mark.parametrize(
    ("before", "after", "last"), [(1, 2, 23), (2, 1, 11), (1, 3, 35), (1, 0.5, 11), (2, 1.5, 17), (2, 0.25, 11)]
)
def test_the_first_stage_reaches_as_far_at_any_input_scale(before: float, after: float, last: int) -> None:
    config = AnyNetConfig().with_input_scale(before)
    assert config.with_input_scale(after).first_stage.range == (0, last)
    assert config.with_input_scale(after).residual_stages == config.residual_stages
    assert config.with_input_scale(before) == config


def test_a_flat_first_stage_keeps_its_range_whatever_the_input_scale() -> None:
    config = presets.default()
    assert config.with_input_scale(2) == replace(config, input_scale=2)
    assert [config.with_input_scale(scale).reach for scale in (0.5, 1, 2)] == [384, 192, 96]
    assert [presets.large().with_input_scale(scale).reach for scale in (0.5, 1, 2)] == [384, 192, 192]


def test_input_scale_is_shared_by_network_and_caller() -> None:
    parts = {scale: (replace(AnyNetConfig(), input_scale=scale)) for scale in (0.5, 1, 1.5, 2, 3, 4)}
    assert {scale: (c.enlargement, c.zoom) for scale, c in parts.items()} == {
        0.5: (1, 0.5),
        1: (1, 1),
        1.5: (1, 1.5),
        2: (2, 1),
        3: (2, 1.5),
        4: (2, 2),
    }
    assert (parts[1].stride, parts[1].finest) == (16, 4)
    assert (parts[2].stride, parts[2].finest) == (8, 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"features.blocks": 1}, "residual_stages.ranges for each of 1 stages"),
        ({"residual_stages.channels": [4]}, "residual_stages.channels for each of 2 stages .*, got 1"),
        ({"first_stage.dims": 4}, "dims as an integer from 2 to 3, got 4"),
        (
            {"first_stage.dims": 2},
            "an hourglass and no fine_costs with 2 dims, .*, got hourglass 0 and fine_costs False",
        ),
        (
            {"first_stage.layers": 0, "first_stage.hourglass": 1, "first_stage.fine_costs": True},
            "layers above 0 with fine_costs and an hourglass, got 0",
        ),
        ({"first_stage.dims": 2, "first_stage.hourglass": 1, "groups": 0}, "groups above 0 with .* 2 dims, got 0"),
        ({"input_scale": 0}, "input_scale from 0.0625 to 4, got 0"),
        ({"input_scale": float("nan")}, "input_scale from 0.0625 to 4, got nan"),
        ({"input_scale": True}, "input_scale from 0.0625 to 4, got True"),
        ({"input_scale": "2"}, "input_scale from 0.0625 to 4, got '2'"),
        ({"features.channels": 0}, "channels as an integer from 1 to 64, got 0"),
        ({"features.channels": 1000}, "channels as an integer from 1 to 64, got 1000"),
        ({"features.channels": 1.0}, "channels as an integer from 1 to 64, got 1.0"),
        ({"features.channels": True}, "channels as an integer from 1 to 64, got True"),
        ({"features.blocks": 60}, "blocks as an integer from 1 to 5, got 60"),
        ({"features.layers": 10**7}, "layers as an integer from 1 to 16, got 10000000"),
        ({"groups": 3}, "groups to divide the finest features' 2 channels, got 3"),
        ({"first_stage.hourglass": -1}, "hourglass as an integer from 0 to 4, got -1"),
        ({"first_stage.layers": -1}, "layers as an integer from 0 to 16, got -1"),
        ({"first_stage.channels": 3000}, "channels as an integer from 1 to 256, got 3000"),
        ({"first_stage.range": [0, 10**5]}, "range as .first, last., .* from -1024 to 1024, got .0, 100000."),
        ({"first_stage.range": [3]}, "range as .first, last."),
        ({"first_stage.range": [0, 2**64]}, "range as .first, last."),
        ({"first_stage.fine_costs": 1}, "fine_costs as true or false, got 1"),
        ({"residual_stages.candidate_radius": 2**63 - 1}, "candidate_radius as an integer from 0 to 64"),
        ({"residual_stages.candidate_radius": -1}, "candidate_radius as an integer from 0 to 64, got -1"),
        (
            {"residual_stages.candidate_radius": 1, "residual_stages.reverse": True},
            "one of candidate_radius, reverse and full_range",
        ),
        ({"residual_stages.ranges": [[2, -2], [-2, 2]]}, "first <= last"),
        ({"residual_stages.ranges": 3}, "ranges, one per stage, got 3"),
        ({"residual_stages.channels": [-1, 2]}, "channels from 1 to 256"),
        ({"refinement.directions": [0, 0]}, "distinct"),
        ({"refinement.directions": []}, "directions of distinct"),
        ({"refinement.directions": [0.0]}, "directions of distinct"),
        ({"refinement.directions": "0"}, "directions of distinct"),
        ({"depth": 2}, "options among input_scale, .*, got 'depth'"),
        ({"features.depth": 2}, "options among channels, blocks, layers, separate, got 'features.depth'"),
        ({"stem.depth": 2}, "a part among features, first_stage, residual_stages, refinement, got 'stem'"),
    ],
)
def test_impossible_configurations(options: dict[str, object], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        AnyNetConfig().with_options(options)


def test_a_part_of_another_kind() -> None:
    with pytest.raises(AnyNetError, match="expected features as FeaturesConfig, got FirstStageConfig"):
        AnyNetConfig(features=FirstStageConfig())  # type: ignore[arg-type]
    with pytest.raises(AnyNetError, match="FeaturesConfig: expected options by name, got 3"):
        AnyNetConfig.from_dict({"features": 3})
