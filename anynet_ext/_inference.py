"""Operators that deployment alone needs: float32, on the CPU, without gradients."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from anynet_ext import _library  # noqa: F401  (loads the operators)


def stem(
    left: Tensor,
    right: Tensor,
    mean: Tensor,
    weight_first: Tensor,
    bias_first: Tensor,
    weight_second: Tensor,
    scale: Tensor,
    shift: Tensor,
    *,
    multiple: int = 4,
) -> Tensor:
    """AnyNet's first layers on images in bytes, in one pass without intermediate tensors.

    Both images, less `mean`, go through a 3x3 convolution, ReLU, a 3x3 convolution with stride 2, 2x2 max pooling, a
    per-channel affine, and ReLU. Before that they are extended at the right and the bottom by repeating their last
    column and row, to sizes that `multiple` divides; the convolutions' own padding is zeros.

    Args:
        left, right: [H, W, 3] uint8, contiguous.
        mean: [3] float32, as are all that follow; in the images' units.
        weight_first, bias_first: [C, 3, 3, 3], [C].
        weight_second: [C, C, 3, 3].
        scale, shift: [C].
        multiple: a multiple of 4.

    Returns:
        [2, C, H' / 4, W' / 4] float32, H' and W' the extended size.

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.

    Source: AnyNet paper (arXiv 1810.11408), Table I.
    """
    out: Tensor = torch.ops.anynet.stem(
        left, right, mean, weight_first, bias_first, weight_second, scale, shift, multiple
    )
    return out


def upsample_sum(
    maps: Sequence[Tensor], ratios: Sequence[int], height: int, width: int, *, gain: float = 1.0
) -> Tensor:
    """Small maps enlarged to one size, and added: `gain * sum_i bilinear(maps[i])`.

    Interpolation is PyTorch's with align_corners=False, map i being enlarged `ratios[i]` times in both directions; of
    the result, the top left `height` x `width`.

    Args:
        maps: 1 to 8, each [H_i, W_i] float32, contiguous, with ratios[i] * H_i >= height, and likewise across.

    Returns:
        [height, width] float32.

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.
    """
    out: Tensor = torch.ops.anynet.upsample_sum(list(maps), list(ratios), gain, height, width)
    return out


@torch.library.register_fake("anynet::stem")
def _fake_stem(
    left: Tensor,
    right: Tensor,
    mean: Tensor,
    weight_first: Tensor,
    bias_first: Tensor,
    weight_second: Tensor,
    scale: Tensor,
    shift: Tensor,
    multiple: int,
) -> Tensor:
    height, width = (-(-size // multiple) * multiple for size in left.shape[:2])
    return mean.new_empty(2, bias_first.shape[0], height // 4, width // 4)


@torch.library.register_fake("anynet::upsample_sum")
def _fake_upsample_sum(maps: list[Tensor], ratios: list[int], gain: float, height: int, width: int) -> Tensor:
    return maps[0].new_empty(height, width)


def _no_gradient(*_: object) -> None:
    raise RuntimeError("stem and upsample_sum have no gradients: they are for inference")


for _name in ("stem", "upsample_sum"):
    torch.library.register_autograd(f"anynet::{_name}", _no_gradient)
