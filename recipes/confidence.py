"""Fits the confidence model of weights, and writes it beside them as NAME.confidence.json.

    anynet render --out rendered --count 64 --seed 600000
    python recipes/confidence.py --weights default --rendered rendered --real "kitti2015:DATA/kitti2015?without=VAL.TXT"

A logistic regression of second order on pixels of rendered pairs, whose truth is dense and exact, tells what speaks for
and against a disparity. Rendered pairs are harder than photographs, so its answer, a log-odds, is then scaled and
shifted to fit photographs (Platt scaling: two numbers per stage).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from anynet import load_checkpoint
from anynet.checkpoint import find_weights
from anynet.data import Dataset, open_dataset
from anynet.errors import AnyNetError
from anynet.evaluation.evaluate import region_mask
from anynet.evaluation.metrics import within_d1
from anynet.evaluation.truth import check_counted
from anynet.model.confidence import PIXEL, ConfidenceModel, gather_evidence, products, surroundings, view_difference
from anynet.model.deploy import DeployedAnyNet, sum_at

Pixels = tuple[Tensor, Tensor]  # evidence [M, F + 1], the last of the left-right check; whether they are right [M]


@torch.no_grad()
def collect(network: DeployedAnyNet, samples: Dataset, per_pair: int) -> list[Pixels]:
    """For every stage, random pixels of all pairs."""
    rng = np.random.default_rng(0)
    found: list[list[Pixels]] = [[] for _ in range(network.config.stages)]
    for sample in samples:
        ys, xs = np.nonzero(region_mask(sample, "all"))
        chosen = rng.permutation(len(ys))[:per_pair]
        ys, xs = ys[chosen], xs[chosen]
        truth = sample.disparity[ys, xs]
        left, right = (torch.from_numpy(np.array(image)) for image in (sample.left, sample.right))
        size = sample.disparity.shape
        mirrored = network.stages(right.flip(1), left.flip(1))
        for pixels, result, other in zip(found, network.stages(left, right), mirrored, strict=True):
            disparity = result()
            evidence = gather_evidence(network, result, left, right)
            difference = view_difference(disparity, other().flip(1)).abs()
            parts = [(evidence.channels, 1), (products(evidence.channels), 1), *surroundings(evidence.channels)]
            values = [sum_at([c], [side * evidence.scale], size)[ys, xs] for channels, side in parts for c in channels]
            rows = torch.stack([*values, (difference[ys, xs] + PIXEL).log()], 1)
            right_ones = within_d1(disparity.numpy()[ys, xs], truth)
            pixels.append((rows.double(), torch.from_numpy(right_ones).double()))
    return [(torch.cat(rows), torch.cat(right)) for rows, right in (zip(*p, strict=True) for p in found)]


def regress(x: Tensor, y: Tensor) -> Tensor:
    """Coefficients [F + 1] of the logistic regression of y [M] on x [M, F], kept small; the constant last."""
    mean, deviation = x.mean(0), x.std(0) + 1e-3
    z = F.pad((x - mean) / deviation, (0, 1), value=1.0)
    w = torch.zeros(z.shape[1], dtype=z.dtype, requires_grad=True)
    optimizer = torch.optim.LBFGS([w], max_iter=200, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        value = F.binary_cross_entropy_with_logits(z @ w, y) + 1e-3 * w[:-1].square().sum()
        value.backward()
        return value

    optimizer.step(loss)
    w = w.detach()
    slopes = w[:-1] / deviation
    return torch.cat([slopes, (w[-1] - slopes @ mean)[None]])


def fit(rendered: Pixels, real: Pixels, checked: bool) -> Tensor:
    (x, y), (x_real, y_real) = rendered, real
    if not checked:
        x, x_real = x[:, :-1], x_real[:, :-1]
    w = regress(x, y)
    scale, shift = regress((x_real @ w[:-1] + w[-1])[:, None], y_real)
    w = scale * w
    w[-1] += shift
    return w


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", default="default")
    parser.add_argument("--rendered", type=Path, required=True)
    parser.add_argument("--real", required=True, help="photographs with ground truth, as `anynet evaluate --data`")
    parser.add_argument("--per-pair", type=int, default=3000)
    options = parser.parse_args()
    if options.per_pair < 1:
        raise AnyNetError(f"--per-pair: expected at least 1 pixel, got {options.per_pair}")
    network = DeployedAnyNet(load_checkpoint(options.weights))
    if network.config.zoom != 1:
        raise AnyNetError(f"{options.weights}: expected an input_scale of 1 or 2, got {network.config.input_scale:g}")
    data = {name: open_dataset(name) for name in (f"rendered:{options.rendered}", options.real)}
    for name, samples in data.items():
        check_counted(name, samples)  # before the work
    pixels = [collect(network, samples, options.per_pair) for samples in data.values()]
    models = [[fit(*stage, checked) for stage in zip(*pixels, strict=True)] for checked in (False, True)]
    path = find_weights(options.weights).with_suffix(".confidence.json")
    ConfidenceModel(*models).write(path)
    print(path)


if __name__ == "__main__":
    try:
        main()
    except AnyNetError as error:
        sys.exit(str(error))
