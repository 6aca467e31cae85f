from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from anynet import AnyNetError, Predictor
from anynet.checkpoint import PACKAGED
from anynet.model.confidence import (
    BLOCKS,
    PIXEL,
    PLACE,
    ConfidenceModel,
    Evidence,
    coefficient_count,
    evidence_count,
    gather_evidence,
    products,
    surroundings,
)
from anynet.model.cost_volume import Distribution


def planes(near: int = 24, far: int = 8) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A textured square before a textured wall; what of the wall the right camera does not see."""
    rng = np.random.default_rng(0)
    height, width = 192, 384
    wall, square = (np.kron(rng.integers(0, 256, (64, 200, 3)), np.ones((3, 3, 1))).astype(np.uint8) for _ in range(2))
    left, right = wall[:height, :width].copy(), wall[:height, far : width + far].copy()
    rows, begin, end = slice(48, 144), 160, 260
    left[rows, begin:end] = square[rows, begin:end]
    right[rows, begin - near : end - near] = square[rows, begin:end]
    hidden = np.zeros((height, width), bool)
    hidden[rows, begin - (near - far) : begin] = True
    hidden[:, :far] = True
    return left, right, hidden


@pytest.mark.parametrize("left_right", [False, True])
@pytest.mark.parametrize("weights", ["default", "large"])
def test_occlusion_of_a_square_before_a_wall(weights: str, left_right: bool) -> None:
    left, right, hidden = planes()
    estimate = Predictor(weights).predict(left, right, confidence=True, left_right=left_right)
    assert estimate.occluded is not None
    inner = np.s_[60:132, 20:]  # past the image's border and the square's corners
    found, expected = estimate.occluded[inner], hidden[inner]
    assert found[expected].mean() > (0.6 if left_right else 0.3)
    assert found[~expected].mean() < 0.08


@pytest.mark.parametrize("weights", ["default", "large", "kitti"])
def test_sure_of_texture_and_unsure_of_noise(weights: str) -> None:
    left, right, hidden = planes()
    predictor = Predictor(weights)
    noise = np.random.default_rng(1).integers(0, 256, right.shape, dtype=np.uint8)
    for good, bad in zip(
        predictor.stages(left, right, confidence=True), predictor.stages(left, noise, confidence=True), strict=True
    ):
        assert good.confidence is not None
        assert bad.confidence is not None
        assert good.confidence.dtype == np.float32
        assert good.confidence.shape == left.shape[:2]
        assert 0 <= good.confidence.min() <= good.confidence.max() <= 1
        assert good.confidence[~hidden].mean() > bad.confidence.mean() + 0.2


def test_deviation() -> None:
    costs = torch.tensor([0.0, 100, 0]).view(1, 3, 1, 1)
    assert Distribution(costs, -1).deviation().item() == pytest.approx(1)
    offsets = torch.tensor([5.0, 0]).view(1, 2, 1, 1)
    assert Distribution(torch.tensor([0.0, 0, 100]).view(1, 3, 1, 1), 3, offsets).deviation().item() == pytest.approx(1)
    torch.manual_seed(0)
    cost, offsets = torch.randn(1, 7, 3, 4), torch.randn(1, 2, 3, 4)
    weight = (-cost).softmax(1)
    values = torch.cat([torch.arange(-2.0, 3).view(1, 5, 1, 1).expand(1, 5, 3, 4), offsets], 1)
    mean = (weight * values).sum(1, keepdim=True)
    expected = (weight * (values - mean) ** 2).sum(1)[0].sqrt()
    distribution = Distribution(cost, -2, offsets)
    torch.testing.assert_close(distribution.deviation(), expected, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(distribution.deviation(2), expected[::2, ::2], atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("weights", ["default", "large"])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (37, 61)])
def test_evidence_of_any_size(weights: str, height: int, width: int) -> None:
    network = Predictor(weights)._network
    image = torch.zeros(height, width, 3, dtype=torch.uint8)
    with torch.inference_mode():
        for stage, result in enumerate(network.stages(image, image), start=1):
            evidence = gather_evidence(network, result, image, image)
            assert len(evidence.channels) == evidence_count(stage, last=stage == 4)
            assert evidence.channels.isfinite().all()


def test_products() -> None:
    channels = torch.rand(3, 2, 2, generator=torch.Generator().manual_seed(0))
    expected = [channels[i] * channels[j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
    torch.testing.assert_close(products(channels), torch.stack(expected))


def test_surroundings() -> None:
    channels = torch.rand(7, 33, 50, generator=torch.Generator().manual_seed(0))
    blocks = surroundings(channels)
    assert [side for _, side in blocks] == list(BLOCKS)
    for means, side in blocks:
        inside = means[:, : 33 // side, : 50 // side]
        torch.testing.assert_close(inside, F.avg_pool2d(channels[PLACE:], side))
        assert means.shape == (7 - PLACE, -(-33 // side), -(-50 // side))


def test_probability_is_a_regression_of_second_order() -> None:
    generator = torch.Generator().manual_seed(0)
    evidence = Evidence(torch.rand(6, 5, 7, generator=generator), torch.zeros(5, 7), 8)
    parts = [(evidence.channels, 1), (products(evidence.channels), 1), *surroundings(evidence.channels)]
    coefficients = torch.randn(sum(len(channels) for channels, _ in parts) + 2, generator=generator)
    difference = torch.rand(37, 51, generator=generator)
    logit, first = coefficients[-1] * torch.ones(5, 7), 0
    for channels, side in parts:
        part = (coefficients[first : first + len(channels), None, None] * channels).sum(0)
        logit = logit + enlarged(part, side, (5, 7))
        first += len(channels)
    checked = enlarged(logit, 8, (37, 51)) + coefficients[-2] * (difference + PIXEL).log()
    single = torch.cat([coefficients[:-2], coefficients[-1:]])
    model = ConfidenceModel([single], [coefficients])
    torch.testing.assert_close(model.probability(1, evidence, (37, 51)), enlarged(logit.sigmoid(), 8, (37, 51)))
    torch.testing.assert_close(model.probability(1, evidence, (37, 51), difference), checked.sigmoid())


def enlarged(x: torch.Tensor, factor: int, size: tuple[int, int]) -> torch.Tensor:
    out = F.interpolate(x[None, None], scale_factor=factor, mode="bilinear")[0, 0]
    return out[: size[0], : size[1]]


def test_packaged_weights_have_models() -> None:
    for file in PACKAGED.glob("*.safetensors"):
        ConfidenceModel.read(file.with_suffix(".confidence.json"), 4)


HUGE = f'{{"single": [[1{"0" * 400}]], "checked": []}}'  # an integer that no float holds


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"single": [[1, "a"]], "checked": []}', "\xff", HUGE])
def test_damaged_models(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.confidence.json"
    path.write_text(text)
    with pytest.raises(AnyNetError, match="not a confidence model"):
        ConfidenceModel.read(path, 4)


def test_models_of_other_networks(tmp_path: Path) -> None:
    packaged = PACKAGED / "default.confidence.json"
    with pytest.raises(AnyNetError, match="finite coefficients, got"):
        ConfidenceModel.read(packaged, 3)
    content = json.loads(packaged.read_text())
    content["checked"][2][0] = float("nan")
    path = tmp_path / "x.confidence.json"
    path.write_text(json.dumps(content))
    with pytest.raises(AnyNetError, match="finite coefficients"):
        ConfidenceModel.read(path, 4)


def test_model_round_trip(tmp_path: Path) -> None:
    torch.manual_seed(0)
    models = [[torch.randn(coefficient_count(k, k == 2) + more) for k in (1, 2)] for more in (1, 2)]
    ConfidenceModel(*models).write(tmp_path / "x.json")
    read = ConfidenceModel.read(tmp_path / "x.json", 2)
    for ours, theirs in ((models[0], read.single), (models[1], read.checked)):
        for a, b in zip(ours, theirs, strict=True):
            torch.testing.assert_close(a, b, atol=1e-5, rtol=0)


@pytest.mark.parametrize("value", [torch.nan, 1e39])
def test_a_model_that_could_not_be_read_is_not_written(tmp_path: Path, value: float) -> None:
    path = tmp_path / "x.json"
    path.write_text("before")
    good, bad = [torch.zeros(3)], [torch.tensor([0, 1, value], dtype=torch.float64)]
    for models in ((good, bad), (bad, good)):
        with pytest.raises(AnyNetError, match=r"x\.json: expected finite coefficients, got NaN or infinity"):
            ConfidenceModel(*models).write(path)
    assert path.read_text() == "before"
