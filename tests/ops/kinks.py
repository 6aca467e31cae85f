"""At and near the points where derivatives jump: whole-pixel positions (floor) and equal features (sign).

Outside a thin band around them the other tests demand the derivative; inside it these demand one of the one-sided ones,
and exactly at the kink the value that the documentation names.
"""

from __future__ import annotations

import torch
from torch import Tensor

from anynet_ext import reference

EPSILONS = [0.0, 1e-12, -1e-12, 1e-7, -1e-7, 1e-5, -1e-5, 1e-3, -1e-3]


def whole_disparities(dtype: torch.dtype) -> Tensor:
    """[1,1,4,23], so that positions lie before, in and behind the image."""
    return torch.randint(-25, 26, (1, 1, 4, 23)).to(dtype)


def slopes(image: Tensor, position: Tensor) -> tuple[Tensor, Tensor]:
    """The two one-sided derivatives of `image` sampled at whole `position`s: towards smaller and larger columns."""
    at = [reference._columns(image, position + step) for step in (-1, 0, 1)]
    return at[1] - at[0], at[2] - at[1]
