"""Networks that the paper compares AnyNet with (arXiv 1810.11408, section IV), on the same operators.

Each is a `Baseline`: normalized images [N, 3, H, W] in, a list of disparity maps [N, 1, H, W] out. `MODELS` builds them
by name for a range of disparities; a `BaselineModel` is one with its configuration, to be trained, stored, evaluated.
"""

from __future__ import annotations

from anynet.baselines.baseline import Baseline
from anynet.baselines.dispnet import DispNetC
from anynet.baselines.model import (
    MODELS,
    BaselineConfig,
    BaselineModel,
    BaselinePredictor,
    load_baseline,
    random_baseline,
)
from anynet.baselines.psmnet import PSMNet, PSMNetBasic
from anynet.baselines.stereodnn import NVTiny, ResNet18Correlation
from anynet.baselines.stereonet import StereoNet

__all__ = [
    "MODELS",
    "Baseline",
    "BaselineConfig",
    "BaselineModel",
    "BaselinePredictor",
    "DispNetC",
    "NVTiny",
    "PSMNet",
    "PSMNetBasic",
    "ResNet18Correlation",
    "StereoNet",
    "load_baseline",
    "random_baseline",
]
