"""Weights of any network as a method to evaluate."""

from __future__ import annotations

import numpy as np
import pytest

from anynet import AnyNet, Predictor, save_checkpoint
from anynet.baselines import BaselineConfig, BaselineModel, BaselinePredictor
from anynet.errors import AnyNetError
from anynet.evaluation.methods import open_method

LEFT, RIGHT = np.random.default_rng(0).integers(0, 256, (2, 32, 64, 3), np.uint8)


def test_anynets_stages(tmp_path):
    path = tmp_path / "anynet.safetensors"
    save_checkpoint(path, AnyNet())
    own, expected = (list(method(LEFT, RIGHT)) for method in (open_method(path), Predictor(path).stages))
    assert [estimate.stage for estimate in own] == [1, 2, 3, 4]
    for one, other in zip(own, expected, strict=True):
        np.testing.assert_array_equal(one.disparity, other.disparity)
    assert len(list(open_method("default", threads=1, input_scale=0.5)(LEFT, RIGHT))) == 4


def test_a_baselines_estimate(tmp_path):
    path = tmp_path / "weights.safetensors"
    model = BaselineModel(BaselineConfig(model="nvtiny", max_disparity=16))
    save_checkpoint(path, model)
    (estimate,) = open_method(path, threads=1)(LEFT, RIGHT)
    (expected,) = BaselinePredictor(model).stages(LEFT, RIGHT)
    np.testing.assert_allclose(estimate.disparity, expected.disparity, atol=1e-4)
    with pytest.raises(AnyNetError, match=r"weights.safetensors: expected no input_scale with a baseline"):
        open_method(path, input_scale=2)
    with pytest.raises(AnyNetError, match=r"weights.safetensors: expected precision 'float32' with a baseline"):
        open_method(path, precision="float16")
    with pytest.raises(AnyNetError, match="expected device 'cpu', 'cuda', 'cuda:N' or 'auto', got 'gpu'"):
        open_method(path, device="gpu")
