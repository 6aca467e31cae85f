"""Occlusions of a disparity map, filled."""

from __future__ import annotations

import torch
from torch import Tensor

from anynet_ext import _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register_inference


@overridable
def fill_occlusions(disparity: Tensor, pixel: float) -> Tensor:
    """A left disparity map with its occlusions filled from the background beside them. For inference.

    Pixels out of the right image's view take the disparity of their right neighbor, occluded ones that of their left
    neighbor, one after another; those within two pixels of the edge of an occlusion only in part.

    Args:
        disparity: [N, 1, H, W] float32, contiguous, finite.
        pixel: the width of a column in disparity's unit, finite and above 0 as float32.

    Returns:
        [N, 1, H, W].

    Raises:
        RuntimeError: if an argument has the wrong dtype, layout or value.
    """
    out: Tensor = torch.ops.anynet.fill_occlusions(disparity, pixel)
    return out


def _fake_fill_occlusions(disparity: Tensor, pixel: float) -> Tensor:
    return torch.empty_like(disparity, memory_format=torch.contiguous_format)


register_inference("fill_occlusions", _fake_fill_occlusions)
