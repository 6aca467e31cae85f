from __future__ import annotations

import numpy as np
import pytest

from anynet.data import StereoSample
from anynet.evaluation import opencv
from anynet.evaluation.evaluate import Method, evaluate


@pytest.mark.parametrize("method", [opencv.bm, opencv.sgbm])
def test_opencv_finds_a_shifted_texture(method: Method) -> None:
    scene = np.random.default_rng(0).integers(0, 256, (60, 420, 3), np.uint8)
    truth = np.full((60, 400), 20, np.float32)
    sample = StereoSample(scene[:, :400], scene[:, 20:420], truth, np.ones_like(truth, bool))
    (stage,) = evaluate(method, [sample]).stages
    assert stage.density > 50
    assert stage.mean.bad1 < 15
