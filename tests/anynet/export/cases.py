"""Networks and images that the tests of exports share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anynet import AnyNetConfig, Predictor
from anynet.checkpoint import PACKAGED
from anynet.model import presets

WEIGHTS = sorted(file.stem for file in PACKAGED.glob("*.safetensors"))
# Each with an option that no packaged weights have, on networks that are small otherwise.
OPTIONS = {
    "two dimensions": {
        "first_stage.dims": 2,
        "first_stage.layers": 1,
        "first_stage.hourglass": 2,
        "first_stage.excitation": True,
    },
    "separate": {"features.separate": True},
    "concatenated": {"groups": 0},
    "full range": {"residual_stages.full_range": True},
    "reverse": {"residual_stages.reverse": True},
    "all directions": {"refinement.directions": [0, 1, 2, 3]},
    "three blocks": {
        "features.blocks": 3,
        "residual_stages.ranges": [[-1, 1], [-1, 1], [-1, 1]],
        "residual_stages.channels": [4, 4, 4],
    },
    "candidates": {"residual_stages.candidate_radius": 1, "refinement.warp_error": True},
    "many channels": {"first_stage.channels": 40, "first_stage.layers": 1},
}


def network(name: str) -> AnyNetConfig:
    return presets.paper().with_options({"first_stage.channels": 4, **OPTIONS[name]})


@dataclass(frozen=True)
class Pair:
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]

    def disparities(self, weights: str | Path) -> list[NDArray[np.float32]]:
        return [estimate.disparity for estimate in Predictor(weights).stages(self.left, self.right)]
