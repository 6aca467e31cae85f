"""A stereo network of one's own on AnyNet's operators, trained for some minutes on rendered pairs.

    python examples/own_network.py --minutes 3

Prints the mean error in pixels on pairs that it was not trained on, before and after. It needs no data and no GPU.
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.data import DataLoader

import anynet_ext  # noqa: F401  (loads the operators)
from anynet.data.rendered import Rendered
from anynet.model.anynet import normalize

ops = torch.ops.anynet
HEIGHT, WIDTH = 128, 256  # pixels
LAST = 23  # largest disparity, in pixels of the features, which have a quarter of the images' resolution


class Layer(nn.Module):
    """A 3x3 or 3x3x3 convolution; ReLU is part of the operator."""

    def __init__(self, inputs: int, outputs: int, *, dims: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outputs, inputs, *[3] * dims))
        self.bias = nn.Parameter(torch.zeros(outputs))
        self.stride, self.relu = 1, True
        nn.init.kaiming_normal_(self.weight, nonlinearity="relu")

    def forward(self, x: Tensor) -> Tensor:
        convolution = ops.conv3x3 if x.dim() == 4 else ops.conv3x3x3
        return convolution(x, self.weight, self.bias, stride=self.stride, relu_out=self.relu)


def layers(*channels: int, dims: int = 2, strides: tuple[int, ...] = ()) -> nn.Sequential:
    """One after the other, the last one without ReLU."""
    network = nn.Sequential(*(Layer(i, o, dims=dims) for i, o in pairwise(channels)))
    for layer, stride in zip(network, strides, strict=False):
        layer.stride = stride
    network[-1].relu = False
    return network


class Network(nn.Module):
    """Two images [N, 3, H, W], normalized, to disparity [N, 1, H, W] in pixels: coarse, and refined."""

    def __init__(self) -> None:
        super().__init__()
        self.features = layers(3, 8, 16, 16, 16, strides=(2, 2))
        self.costs = layers(1, 8, 8, 1, dims=3)
        self.residual = layers(7, 16, 16, 1)

    def forward(self, left: Tensor, right: Tensor) -> list[Tensor]:
        size = left.shape[2:]
        first, second = (self.features(image) for image in (left, right))
        volume = ops.cost_volume(first, second, first=0, last=LAST)[:, None]
        coarse = ops.soft_argmin((volume + self.costs(volume))[:, 0])  # [N, 1, H / 4, W / 4], in pixels of the features
        small = [ops.resize(image, *coarse.shape[2:]) for image in (left, right)]
        warped = ops.warp(small[1], coarse)  # looks like the left image where the disparity is right
        seen = torch.cat([small[0], (warped - small[0]).abs(), coarse / LAST], 1)
        fine = coarse + self.residual(seen)
        return [ops.resize(disparity, *size, scale=4.0) for disparity in (coarse, fine)]


def batches(seed: int, pairs: int, size: int) -> DataLoader[tuple[Tensor, ...]]:
    def collate(samples: list) -> tuple[Tensor, ...]:
        left, right = (
            normalize(torch.stack([torch.from_numpy(getattr(s, side).copy()).permute(2, 0, 1) for s in samples]))
            for side in ("left", "right")
        )
        return left, right, torch.stack([torch.from_numpy(s.disparity)[None] for s in samples])

    return DataLoader(Rendered(pairs, seed, HEIGHT, WIDTH), size, collate_fn=collate, num_workers=1)


@torch.no_grad()
def error(network: Network, held_out: list[tuple[Tensor, ...]]) -> float:
    """Mean difference to the true disparity, where it is in reach."""
    errors = []
    for left, right, truth in held_out:
        errors.append((network(left, right)[-1] - truth).abs()[truth < 4 * LAST])
    return float(torch.cat(errors).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--steps", type=int, default=10**6, help="at most so many")
    options = parser.parse_args()
    torch.manual_seed(0)
    network, held_out = Network(), list(batches(10**6, 8, 4))
    optimizer = torch.optim.Adam(network.parameters(), 2e-3)
    print(f"before: {error(network, held_out):.2f} px")
    end = time.monotonic() + 60 * options.minutes
    step = 0
    for step, (left, right, truth) in enumerate(batches(0, 4 * options.steps, 4), 1):  # noqa: B007 (used after it)
        known = truth < 4 * LAST
        loss = sum(F.smooth_l1_loss(found[known], truth[known]) for found in network(left, right))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if time.monotonic() > end:
            break
    print(f"after {step} steps: {error(network, held_out):.2f} px")


if __name__ == "__main__":
    main()
