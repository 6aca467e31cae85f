"""Recipes: presets, schedules, storage, and the command line made of them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from anynet import AnyNetConfig
from anynet.cli import main
from anynet.errors import AnyNetError
from anynet.training.recipe import PRESETS, Recipe, preset


def test_the_papers_presets() -> None:
    for name in ("paper-sceneflow", "paper-kitti"):
        recipe = PRESETS[name]
        assert (recipe.batch_size, recipe.crop_size, recipe.learning_rate) == (6, (256, 512), 5e-4)
        assert recipe.stage_weights_of(4) == (0.25, 0.5, 1.0, 1.0)
        assert not recipe.augment
    scene_flow, kitti = PRESETS["paper-sceneflow"], PRESETS["paper-kitti"]
    assert scene_flow.length(600) == 10 * 100
    assert {scene_flow.learning_rate_at(step, 1000) for step in range(1000)} == {5e-4}
    assert kitti.length(160) == 8000
    rates = [kitti.learning_rate_at(step, 300) for step in (0, 199, 200, 299)]
    assert rates == pytest.approx([5e-4, 5e-4, 5e-5, 5e-5])


def test_warmup_and_cosine() -> None:
    recipe = Recipe(steps=1000, learning_rate=1.0, warmup_steps=9)
    rates = [recipe.learning_rate_at(step, 1000) for step in range(1000)]
    assert rates[0] == pytest.approx(0.1)
    assert max(rates) == pytest.approx(1.0, abs=1e-3)
    assert rates[500] == pytest.approx(0.5)
    assert 0 < rates[-1] < 1e-5


def test_a_stored_recipe_is_the_same(tmp_path: Path) -> None:
    network = AnyNetConfig().with_options({"features.channels": 2, "first_stage.range": (0, 23)})
    recipe = replace(PRESETS["kitti"], data=("kitti2015:a", "eth3d:b"), network=network, epochs=None)
    file = tmp_path / "recipe.json"
    file.write_text(recipe.to_json())
    assert Recipe.load(file) == recipe


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"network": {"depth": 3}}', '{"network": {}, "rate": 1e-3}'])
def test_another_file_or_version_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "recipe.json"
    file.write_text(text)
    with pytest.raises(AnyNetError, match=r"recipe\.json: expected a recipe of this version, got [^\n]*$"):
        Recipe.load(file)
    with pytest.raises(AnyNetError, match=r"cannot read .*nowhere\.json: No such file or directory"):
        Recipe.load(tmp_path / "nowhere.json")


def test_steps_replace_epochs() -> None:
    assert preset("paper-kitti", steps=7).length(1000) == 7
    assert preset("default", epochs=2).length(600) == 200
    with pytest.raises(AnyNetError, match="either steps or epochs"):
        preset("default", steps=7, epochs=2).length(1000)
    with pytest.raises(AnyNetError, match="no preset 'fast'; there are paper-sceneflow"):
        preset("fast")


@pytest.mark.parametrize("weights", [(1.0, -1.0), (0.0, 0.0), (1.0, math.inf), (math.nan, 1.0)])
def test_stage_weights_must_weigh_something(weights: tuple[float, ...]) -> None:
    with pytest.raises(AnyNetError, match="none below 0 and one above"):
        Recipe(stage_weights=weights).stage_weights_of(2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"batch_size": 0}, "batch_size must be at least 1, got 0"),
        ({"crop_size": (32, 512)}, "crop_size must be at least 64x64, got 32x512"),
        ({"crop_size": (10**9, 64)}, "crop_size must have at most 67108864 pixels, got 1000000000x64"),
        ({"learning_rate": float("nan")}, "learning_rate must be positive, got nan"),
        ({"learning_rate": math.inf}, "learning_rate must be finite, got inf"),
        ({"smooth_below": math.inf}, "smooth_below must be finite, got inf"),
        ({"robust_scale": math.inf}, "robust_scale must be finite, got inf"),
        ({"max_grad_norm": math.inf}, "max_grad_norm must be finite, got inf"),
        ({"ema_decay": 1.0}, "ema_decay must be in"),
        ({"schedule": "linear"}, "constant, step or cosine, got 'linear'"),
        ({"input_scale": 0, "model": "nvtiny"}, "Recipe: expected input_scale from 0.0625 to 4, got 0"),
        ({"input_scale": math.nan, "weights": "paper"}, "Recipe: expected input_scale from 0.0625 to 4, got nan"),
        ({"input_scale": 2}, "input_scale is for weights to start from"),
        ({"load_partial": True}, "load_partial is for weights to start from"),
        ({"device": "gpu"}, "device must be cpu or cuda, got 'gpu'"),
        ({"max_grad_norm": -1.0}, "max_grad_norm must be positive or 0, got -1.0"),
    ],
)
def test_impossible_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(AnyNetError, match=message):
        Recipe(**options)


def test_resuming_may_change_how_to_run_but_not_what_to_learn() -> None:
    before = Recipe(steps=10)
    before.check_resumed(replace(before, workers=3, threads=1, log_every=1))
    with pytest.raises(AnyNetError, match="steps was 10 when the run began, so it cannot be 20"):
        before.check_resumed(replace(before, steps=20))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("threads", 10**6, "threads: expected 1 to 256, got 1000000"),
        ("workers", 10**6, "workers: expected 0 to 256, got 1000000"),
        ("workers", -1, "workers: expected 0 to 256, got -1"),
        ("threads", 1.5, r"threads: expected int \| None, got 1.5"),
        ("batch_size", "6", "batch_size: expected int, got '6'"),
        ("batch_size", True, "batch_size: expected int, got True"),
        ("amp", 1, "amp: expected bool, got 1"),
        ("crop_size", (64,), r"crop_size: expected tuple\[int, int\], got \(64,\)"),
        ("stage_weights", ("a",), r"stage_weights: expected tuple\[float, ...\], got \('a',\)"),
        ("data", "kitti2015:a", r"data: expected tuple\[str, ...\], got 'kitti2015:a'"),
        ("learning_rate", None, "learning_rate: expected float, got None"),
        ("network", {}, r"network: expected AnyNetConfig, got \{\}"),
        ("milestone", float("nan"), "milestone: expected 0 to 1, got nan"),
        ("seed", -1, "seed: expected 0 to"),
    ],
)
def test_options_of_the_wrong_type_or_size(tmp_path, name, value, message):
    with pytest.raises(AnyNetError, match=message):
        Recipe(**{name: value})
    if isinstance(value, (int, float, str, type(None))) and value == value:  # also from a file
        stored = {**json.loads(Recipe().to_json()), name: value}
        (tmp_path / "recipe.json").write_text(json.dumps(stored))
        with pytest.raises(AnyNetError, match=rf"recipe\.json: expected a recipe of this version.*{message}"):
            Recipe.load(tmp_path / "recipe.json")


@pytest.mark.parametrize("value", ["channels=" + "[" * 5000, "channels=" + "9" * 5000, "channels", "channels=x"])
def test_a_network_option_that_cannot_be_parsed(capsys, tmp_path, value):
    assert main(["train", "--out", str(tmp_path), "--data", "render:1", "--network", value]) == 2
    assert "--network: expected " in capsys.readouterr().err


def test_resuming_may_change_what_is_measured() -> None:
    before = Recipe(steps=10, validation=("render:1",))
    before.check_resumed(replace(before, validation=()))


def test_a_file_without_all_options_is_refused(tmp_path: Path) -> None:
    values = json.loads(Recipe(steps=10).to_json())
    del values["far_weight"]
    (tmp_path / "recipe.json").write_text(json.dumps(values))
    with pytest.raises(AnyNetError, match=r"expected a recipe of this version.*no far_weight"):
        Recipe.load(tmp_path / "recipe.json")
