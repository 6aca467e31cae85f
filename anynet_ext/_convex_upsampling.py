"""Convex upsampling."""

from __future__ import annotations

import torch
from torch import Tensor

from anynet_ext import _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register_inference


@overridable
def convex_upsampling(input: Tensor, logits: Tensor) -> Tensor:
    """Upsampling by two, each pixel a mean of the 3x3 around it, weighted by a softmax. For inference.

    Args:
        input: [N, 1, H, W] float32, contiguous; padded by replication.
        logits: [N, 32, H, W] float32, contiguous: of the four pixels that one becomes, row by row, those of its eight
            neighbors, row by row; its own is 0.

    Returns:
        [N, 1, 2H, 2W].

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape or layout.

    Source: Teed and Deng, "RAFT" (arXiv 2003.12039), section 3.3.
    """
    out: Tensor = torch.ops.anynet.convex_upsampling(input, logits)
    return out


def _fake_convex_upsampling(input: Tensor, logits: Tensor) -> Tensor:
    n, _, h, w = input.shape
    return input.new_empty(n, 1, 2 * h, 2 * w)


register_inference("convex_upsampling", _fake_convex_upsampling)
