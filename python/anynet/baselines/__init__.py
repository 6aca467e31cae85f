"""Networks that the paper compares AnyNet with (arXiv 1810.11408, section IV), on the same operators.

Each is a `Baseline`: normalized images [N, 3, H, W] in, a list of disparity maps [N, 1, H, W] out. `MODELS` builds them
by name for a range of disparities.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from anynet.baselines.baseline import Baseline
from anynet.baselines.dispnet import DispNetC
from anynet.baselines.psmnet import PSMNet, PSMNetBasic
from anynet.baselines.stereodnn import NVTiny, ResNet18Correlation
from anynet.baselines.stereonet import StereoNet
from anynet.errors import AnyNetError

__all__ = [
    "MODELS",
    "Baseline",
    "DispNetC",
    "NVTiny",
    "PSMNet",
    "PSMNetBasic",
    "ResNet18Correlation",
    "StereoNet",
    "build",
]

MODELS: dict[str, Callable[[int], Baseline]] = {
    "psmnet": PSMNet,
    "psmnet-basic": PSMNetBasic,
    "stereonet-8x": StereoNet,
    "stereonet-16x": partial(StereoNet, halvings=4),
    "dispnetc": DispNetC,
    "resnet18-2d": ResNet18Correlation,
    "nvtiny": NVTiny,
}
"""From a name and the largest disparity, in pixels of the images given, to a network with random weights."""


def build(name: str, max_disparity: int = 192) -> Baseline:
    """The named network of `MODELS`.

    Raises:
        AnyNetError: if there is none of that name.
    """
    if name not in MODELS:
        raise AnyNetError(f"expected a model of {', '.join(MODELS)}, got {name!r}")
    return MODELS[name](max_disparity)
