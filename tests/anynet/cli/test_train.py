from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest

from anynet import AnyNetConfig
from anynet.cli import main
from anynet.training.recipe import PRESETS, Recipe


def test_every_field_is_an_option(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Recipe] = []
    monkeypatch.setattr("anynet.training.loop.train", lambda recipe, out, resume: asked.append(recipe) or out)
    arguments = [
        "--network",
        "features.channels=2",
        "--stage-weights",
        "1",
        "--stage-weights",
        "2",
        "--crop-size",
        "64",
        "128",
    ]
    arguments += ["--data", "render:3", "--data", "render:4", "--no-augment", "--schedule", "constant", "--epochs", "3"]
    assert main(["train", "--preset", "paper", "--out", str(tmp_path), *arguments]) == 0
    expected = replace(
        PRESETS["paper"],
        network=AnyNetConfig().with_options({"features.channels": 2}),
        stage_weights=(1.0, 2.0),
        crop_size=(64, 128),
        data=("render:3", "render:4"),
        augment=False,
        schedule="constant",
        epochs=3,
        steps=None,
    )
    assert asked == [expected]
    assert main(["finetune", "--out", str(tmp_path)]) == 0
    assert asked[1] == PRESETS["kitti"]
    capsys.readouterr()
    assert main(["train", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"--{field.name.replace('_', '-')}" in text for field in fields(Recipe))
    for options, message in (
        (["--network", "depth=2"], "expected options among input_scale"),
        (["--network", "groups=x"], "or NAME=VALUE with the value in JSON like features.channels=2, got 'groups=x'"),
        (["--resume"], f"{tmp_path}: expected a run to resume (recipe.json), or --data to begin one, got neither"),
    ):
        assert main(["train", "--out", str(tmp_path), *options]) == 2
        assert message in capsys.readouterr().err


def test_an_interrupted_run_says_how_to_go_on(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(recipe: Recipe, out: Path, resume: bool) -> Path:
        (out / "recipe.json").write_text(recipe.to_json())
        raise KeyboardInterrupt

    monkeypatch.setattr("anynet.training.loop.train", interrupted)
    assert main(["finetune", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == (f"anynet: interrupted; to go on: anynet finetune --out {tmp_path} --resume\n")


def test_another_preset_is_refused_on_resuming(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Recipe] = []
    monkeypatch.setattr("anynet.training.loop.train", lambda recipe, out, resume: asked.append(recipe) or out)
    stored = replace(PRESETS["paper"], steps=5, workers=3)
    (tmp_path / "recipe.json").write_text(stored.to_json())
    resume = ["train", "--out", str(tmp_path), "--resume"]
    for options in ([], ["--preset", "paper", "--steps", "5"]):
        assert main([*resume, *options]) == 0
        assert asked.pop() == stored
    for options, message in (
        (["--preset", "fast"], "no preset 'fast'"),
        (["--preset", "large", "--steps", "5"], "network was "),
        (["--preset", "paper"], "steps was 5 when the run began, so it cannot be 8000"),
    ):
        assert main([*resume, *options]) == 2
        assert capsys.readouterr().err.startswith(f"anynet: {message}")
    assert not asked


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "--milestone", "0.5"], "--milestone belongs to --schedule step"),
        (["train", "--validate-every", "5"], "--validate-every belongs to --validation"),
        (
            ["finetune", "--network", "groups=2"],
            "--network belongs to AnyNet from random weights, or to --load-partial",
        ),
        (["train", "--model", "psmnet", "--network", "groups=2"], "--network belongs to AnyNet"),
        (["finetune", "--preset", "default"], "finetune: expected weights to begin with (--weights), got none"),
        (["finetune", "--preset", "paper-kitti"], "finetune: expected weights to begin with (--weights), got none"),
    ],
)
def test_options_that_would_do_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    assert main([*arguments, "--data", "render:1", "--out", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err.startswith(f"anynet: {message}")
    assert not (tmp_path / "run").exists()
