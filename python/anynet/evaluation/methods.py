"""Weights of any network as a method to evaluate."""

from __future__ import annotations

import os

from anynet.baselines.model import BaselinePredictor, load_baseline, stored_config
from anynet.checkpoint import find_weights
from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import Method
from anynet.predictor import Predictor


def open_method(
    weights: str | os.PathLike[str],
    *,
    device: str = "cpu",
    precision: str = "float32",
    threads: int | None = None,
    input_scale: float | None = None,
) -> Method:
    """AnyNet, stage by stage, or a baseline, whichever the weights are of.

    Args:
        weights: a packaged name or a file.
        device, precision: as `Predictor`'s; baselines compute in float32.
        threads: CPU threads; default: as many as PyTorch uses.
        input_scale: as `Predictor`'s; a baseline has its own.

    Raises:
        AnyNetError: if the weights cannot be loaded, the device is not there, or `input_scale` or another precision is
            given for a baseline's.
    """
    path = find_weights(weights)
    if stored_config(path) is None:
        predictor = Predictor(weights, device=device, precision=precision, threads=threads, input_scale=input_scale)
        return predictor.stages
    if precision != "float32":
        raise AnyNetError(f"{path}: expected precision 'float32' with a baseline's weights, got {precision!r}")
    return BaselinePredictor(load_baseline(path, input_scale), device=device, threads=threads).stages
