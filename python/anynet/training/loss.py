"""The training loss: smooth-L1 of every stage over the pixels with known disparity."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

MAX_DISPARITY = 192.0


def loss_mask(disparity: Tensor, valid: Tensor) -> Tensor:
    """Pixels that train: known, and 0 < d < 192. `disparity` float, `valid` bool, both [N,1,H,W] -> float [N,1,H,W]."""
    return (valid & (disparity > 0) & (disparity < MAX_DISPARITY)).to(disparity.dtype)


def stage_losses(outputs: Sequence[Tensor], disparity: Tensor, mask: Tensor, pixels: Tensor) -> Tensor:
    """Smooth-L1 in pixels of each stage, summed over `mask` and divided by `pixels` (paper, section III-D).

    outputs: S tensors [N,1,H,W]; disparity: [N,1,H,W], finite; mask: float [N,1,H,W], 0 or 1;
    pixels: scalar, the mask's sum (over all processes, in which case the losses of the processes add up). -> [S]
    """
    # Gathering the masked pixels instead costs several times as much. The mask's float32 widens half types.
    losses = [F.smooth_l1_loss(out * mask, disparity * mask, reduction="sum") for out in outputs]
    return torch.stack(losses) / pixels
