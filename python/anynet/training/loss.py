"""The training loss: smooth-L1 of every stage, weighted by pixel."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from anynet.samples import MAX_DISPARITY


def loss_weights(disparity: Tensor, weights: Tensor) -> Tensor:
    """The pixels' weights, 0 outside 0 < d < 192, which does not train. All float [N,1,H,W]."""
    return weights * ((disparity > 0) & (disparity < MAX_DISPARITY))


def stage_losses(
    outputs: Sequence[Tensor],
    disparity: Tensor,
    weights: Tensor,
    total: Tensor,
    smooth_below: float = 1.0,
    robust_scale: float = 0.0,
) -> Tensor:
    """Smooth-L1 in pixels of each stage, weighted, summed and divided by `total` (paper, section III-D).

    An error below `smooth_below` counts by its square: the smaller it is, the less it teaches.
    With `robust_scale` c > 0, a loss x counts as c log(1 + x / c): outliers, as they are where nothing can be matched,
    do not drown what can be mended.

    outputs: S tensors [N,1,H,W]; disparity: [N,1,H,W], finite; weights: float32 [N,1,H,W];
    total: scalar, the weights' sum (over all processes, in which case the losses of the processes add up). -> [S]
    """
    losses = [F.smooth_l1_loss(out, disparity, reduction="none", beta=smooth_below) for out in outputs]
    if robust_scale:
        losses = [robust_scale * torch.log1p(loss / robust_scale) for loss in losses]
    return torch.stack([(loss * weights).sum() for loss in losses]) / total
