"""Weights that earlier versions wrote: files in `stored`, and what the networks found in the same images then.

A file is made once, and never again: `python tests/anynet/model/test_stored.py VERSION`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from anynet import Predictor

STORED = Path(__file__).parent / "stored"
FILES = sorted(STORED.glob("*.safetensors"))


def images() -> list[NDArray[np.uint8]]:
    """Blocks of 4 x 4 pixels, the right ones 5 pixels further left."""
    texture = (np.arange(24 * 32 * 3) * 7919 % 251).astype(np.uint8).reshape(24, 32, 3).repeat(4, 0).repeat(4, 1)
    return [np.ascontiguousarray(texture[:80, start : start + 112]) for start in (0, 5)]


def means(path: Path) -> list[float]:
    return [round(float(estimate.disparity.mean()), 4) for estimate in Predictor(path).stages(*images())]


def test_there_are_files() -> None:
    assert len(FILES) >= 2


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_stored_weights_find_what_they_found(path: Path) -> None:
    assert means(path) == pytest.approx(json.loads(path.with_suffix(".json").read_text()), abs=0.01, rel=1e-3)


def main(version: str) -> None:
    from networks import wild

    from anynet import save_checkpoint
    from anynet.model import presets

    small = {
        "features.channels": 2,
        "first_stage.channels": 4,
        "residual_stages.channels": [4, 4],
        "refinement.channels": 2,
    }
    more = {
        "groups": 2,
        "first_stage.hourglass": 1,
        "first_stage.fine_costs": True,
        "first_stage.excitation": True,
        "residual_stages.candidate_radius": 1,
        "refinement.directions": [0, 1],
        "refinement.fill_occlusions": True,
        "refinement.warp_error": True,
        "refinement.convex_upsampling": True,
    }
    for name, options in (("paper", small), ("options", small | more)):
        path = STORED / f"{version}-{name}.safetensors"
        save_checkpoint(path, wild(presets.paper().with_options(options)))
        path.with_suffix(".json").write_text(json.dumps(means(path)) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
