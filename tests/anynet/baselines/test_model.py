"""Baselines by their configuration: resized images, weights on disk, training and evaluation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from anynet import AnyNet, save_checkpoint
from anynet.baselines import BaselineConfig, BaselineModel, BaselinePredictor, load_baseline
from anynet.cli import main
from anynet.data import StereoSample
from anynet.errors import AnyNetError
from anynet.evaluation.methods import open_method
from anynet.model.anynet import normalize
from anynet.model.config import MEAN, STD
from anynet.training.loop import train
from anynet.training.recipe import Recipe
from anynet.training.run_folder import CHECKPOINT, LOG

SMALL = BaselineConfig(model="nvtiny", max_disparity=16)


def _images(height: int = 32, width: int = 64) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    left, right = random.integers(0, 256, (2, height, width, 3), np.uint8)
    return left, right


def normalized(image: Tensor) -> Tensor:
    """[H, W, 3] in bytes as a batch of one."""
    return normalize(image.permute(2, 0, 1)[None])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "psmnot"}, r"expected a model of psmnet, .*, got 'psmnot'"),
        ({"model": "psmnet", "max_disparity": 0}, "max_disparity from 1 to 1024, got 0"),
        ({"model": "psmnet", "max_disparity": 1.5}, "got 1.5"),
        ({"model": "psmnet", "input_scale": 5}, "input_scale from 0.0625 to 4, got 5"),
        ({"model": "psmnet", "input_scale": True}, "got True"),
    ],
)
def test_what_is_no_configuration(options, message):
    with pytest.raises(AnyNetError, match=message):
        BaselineConfig(**options)


def test_resized_images_give_disparity_in_their_own_pixels():
    model = BaselineModel(BaselineConfig(model="nvtiny", max_disparity=64, input_scale=0.25)).eval()
    assert model.network.max_disparity == 16
    seen = []

    def shifted_by_three(left: Tensor, right: Tensor) -> list[Tensor]:
        seen.append((left, right))
        return [torch.full_like(left[:, :1], 3.0)]

    model.network.estimates = shifted_by_three  # type: ignore[method-assign]
    left = torch.arange(128.0).expand(1, 3, 64, 128)
    with torch.inference_mode():
        (estimate,) = model(left, -left)
    assert estimate.shape == (1, 1, 64, 128)
    torch.testing.assert_close(estimate, torch.full_like(estimate, 12))
    ((small, other),) = seen
    assert small.shape == (1, 3, 16, 32)
    torch.testing.assert_close(other, -small)
    torch.testing.assert_close(small[0, 0, 0, 4:-4], 4 * torch.arange(32.0)[4:-4] + 1.5)  # means of four columns


def test_at_most_so_many_stages():
    model = BaselineModel(BaselineConfig(model="stereonet-8x", max_disparity=16))
    left, right = torch.randn(2, 2, 3, 16, 32).unbind()
    assert len(model.loss_weights) == len(model(left, right)) == 4
    assert len(model(left, right, 2)) == 2


def test_images_in_bytes():
    left, right = _images()
    for image, values in ((left, normalized(torch.from_numpy(left))),):
        expected = (image / 255 - MEAN) / STD
        np.testing.assert_allclose(values[0].permute(1, 2, 0).numpy(), expected, atol=1e-5)
    model = BaselineModel(SMALL)
    (estimate,) = BaselinePredictor(model, threads=1).stages(left, right)
    assert estimate.stage == 1
    assert estimate.elapsed_ms > 0
    assert estimate.disparity.dtype == np.float32
    with torch.inference_mode():
        expected = model.eval()(*(normalized(torch.from_numpy(image)) for image in (left, right)))[0][0, 0]
    np.testing.assert_allclose(estimate.disparity, expected, atol=1e-4)
    with pytest.raises(AnyNetError, match="two images of one size"):
        list(BaselinePredictor(model).stages(left, right[:-1]))


def test_weights_on_disk(tmp_path):
    path = tmp_path / "weights.safetensors"
    model = BaselineModel(SMALL)
    save_checkpoint(path, model)
    loaded = load_baseline(path)
    assert loaded.config == SMALL
    assert not loaded.training
    for name, value in model.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value), name


def _broken(path: Path, *, change: dict[str, Tensor] | None = None, config: object = None) -> Path:
    tensors = {**BaselineModel(SMALL).state_dict(), **(change or {})}
    options = {"model": "nvtiny", "max_disparity": 16, "input_scale": 1} if config is None else config
    save_file(tensors, path, {"config": json.dumps(options), "metadata": "{}"})
    return path


def test_weights_of_another_network(tmp_path):
    path = tmp_path / "anynet.safetensors"
    save_checkpoint(path, AnyNet())
    with pytest.raises(AnyNetError, match=r"anynet.safetensors: expected weights of a baseline"):
        load_baseline(path)


@pytest.mark.parametrize(
    ("change", "config", "message"),
    [
        ({"network.features.0.bias": torch.full((32,), torch.nan)}, None, "got NaN or infinity in network.features"),
        ({"network.features.0.bias": torch.zeros(3)}, None, "expected weights of BaselineConfig"),
        ({"another": torch.zeros(3)}, None, "expected weights of BaselineConfig"),
        ({}, {"model": "psmnot"}, "expected a model of"),
        ({}, {"model": "nvtiny", "more": 1}, "expected weights of a baseline"),
        ({}, [1], "expected weights of a baseline"),
    ],
)
def test_broken_weights(tmp_path, change, config, message):
    path = _broken(tmp_path / "broken.safetensors", change=change, config=config)
    with pytest.raises(AnyNetError, match=message) as caught:
        load_baseline(path)
    assert str(path) in str(caught.value)


def test_a_configuration_that_is_too_deep_is_another_network_s(tmp_path):
    path = tmp_path / "deep.safetensors"
    save_file(BaselineModel(SMALL).state_dict(), path, {"config": "[" * 100_000, "metadata": "{}"})
    with pytest.raises(AnyNetError, match=r"deep.safetensors: expected weights of a baseline"):
        load_baseline(path)
    with pytest.raises(AnyNetError, match=r"deep.safetensors: its configuration is not AnyNet's"):
        open_method(path)


class Shifted(list[StereoSample]):
    """Blocks of noise, each with one disparity."""

    def __init__(self, count: int) -> None:
        random = np.random.default_rng(0)
        for i in range(count):
            coarse = random.integers(0, 256, (20, 40, 3), np.uint8)
            scene = coarse.repeat(4, 0).repeat(4, 1)
            shift = 4 + 2 * (i % 3)
            truth = np.full((80, 144), shift, np.float32)
            self.append(
                StereoSample(
                    scene[:, :144], scene[:, shift : 144 + shift], truth, np.ones_like(truth, bool), name=str(i)
                )
            )


RECIPE = Recipe(
    model="resnet18-2d",
    input_scale=0.5,
    steps=4,
    batch_size=2,
    crop_size=(64, 128),
    augment=False,
    workers=0,
    threads=1,
    log_every=1,
    checkpoint_every=2,
    validate_every=4,
    learning_rate=1e-3,
)


def test_training_learns_repeats_and_measures(tmp_path):
    samples = Shifted(4)
    path = train(RECIPE, tmp_path / "whole", data=samples, validation={"two": samples[:2]})
    assert load_baseline(path).config == BaselineConfig(model="resnet18-2d", input_scale=0.5)
    lines = [json.loads(line) for line in (tmp_path / "whole" / LOG).read_text().splitlines()]
    losses = [line["losses"][0] for line in lines if "losses" in line]
    assert len(losses) == 4
    assert losses[-1] < losses[0]
    assert any("two" in json.dumps(line) for line in lines)
    (tmp_path / "part").mkdir()
    train(replace(RECIPE, validate_every=None), tmp_path / "part", data=samples, validation={})
    again = load_baseline(tmp_path / "part" / path.name).state_dict()
    assert all(torch.equal(value, again[name]) for name, value in load_baseline(path).state_dict().items())
    assert (tmp_path / "part" / CHECKPOINT).exists()


def test_recipes_of_baselines():
    with pytest.raises(AnyNetError, match="begins with random ones"):
        Recipe(model="nvtiny", weights="default")
    with pytest.raises(AnyNetError, match="input_scale is for weights"):
        Recipe(input_scale=0.5)
    assert Recipe().stage_weights_of(4) == (0.25, 0.5, 1, 1)
    assert Recipe().stage_weights_of(3, (0.5, 0.7, 1.0)) == (0.5, 0.7, 1.0)
    assert Recipe(stage_weights=(1, 0, 0)).stage_weights_of(3, (0.5, 0.7, 1.0)) == (1, 0, 0)


def test_the_commands(tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--model", "nvtiny", "--input-scale", "0.5", "--steps", "1", "--batch-size", "1", "--workers", "0"]
    data = "render:2?height=64&width=128"
    assert main(["train", "--data", data, "--out", str(out), *options, "--crop-size", "64", "128"]) == 0
    weights = str(out / "weights.safetensors")
    capsys.readouterr()
    command = ["evaluate", "--data", data, "--weights", weights, "--model", "resnet18-2d", "--input-scale", "0.5"]
    assert main(command) == 2
    assert "expected no input_scale with a baseline's weights" in capsys.readouterr().err
    assert main(command[:-2]) == 0
    table = capsys.readouterr().out
    assert table.count(f"| {weights} | {data} | all | 2 | 1 |") == 1
    assert table.count("| resnet18-2d, random weights |") == 1
