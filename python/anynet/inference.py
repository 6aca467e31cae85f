"""The network as it runs in deployment: images in bytes, nothing computed that nobody asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from anynet.network import MEAN, STD, AnyNet


class InferenceGraph:
    """An AnyNet with its weights frozen."""

    def __init__(self, model: AnyNet) -> None:
        self.model = model.eval()
        self.mean = torch.tensor(MEAN)[:, None, None]
        self.std = torch.tensor(STD)[:, None, None]

    def stages(self, left: Tensor, right: Tensor) -> Iterator[Callable[[], Tensor]]:
        """One function per stage, each giving that stage's full-size disparity [H, W].

        Iterating computes a stage at low resolution; only calling the function enlarges its result.

        Args:
            left, right: uint8 RGB, [H, W, 3], contiguous.
        """
        images = [((image.permute(2, 0, 1) / 255 - self.mean) / self.std)[None] for image in (left, right)]
        for estimate in self.model.stages(*images):
            yield lambda estimate=estimate: estimate[0, 0]  # type: ignore[misc]
