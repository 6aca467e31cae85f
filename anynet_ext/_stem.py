"""The network's first layers, on 8-bit images."""

from __future__ import annotations

import torch
from torch import Tensor

from anynet_ext import _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register_inference


@overridable
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
    input_scale: int = 1,
    multiple: int = 4,
) -> Tensor:
    """AnyNet's first layers on 8-bit images, in one pass without intermediate tensors, for inference.

    Both images, less `mean`, go through a 3x3 convolution, ReLU, a 3x3 convolution with stride 2, 2x2 max pooling, a
    per-channel affine, and ReLU. Before that they are upsampled (bilinear, align_corners=False) and padded at the right
    and the bottom by replication, to sizes that `multiple` divides; the convolutions' own padding is zeros.

    Args:
        left, right: [H, W, 3] uint8, contiguous.
        mean: [3] float32, as are all that follow; in 8-bit units.
        weight_first, bias_first: [C, 3, 3, 3], [C].
        weight_second: [C, C, 3, 3].
        scale, shift: [C].
        input_scale: 1 or 2, the factor of the upsampling.
        multiple: a multiple of 4, at most 65536.

    Returns:
        [2, C, H' / 4, W' / 4] float32, H' and W' the upsampled and padded size.

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.

    Source: AnyNet paper (arXiv 1810.11408), Table I.
    """
    out: Tensor = torch.ops.anynet.stem(
        left, right, mean, weight_first, bias_first, weight_second, scale, shift, input_scale, multiple
    )
    return out


def _fake_stem(
    left: Tensor,
    right: Tensor,
    mean: Tensor,
    weight_first: Tensor,
    bias_first: Tensor,
    weight_second: Tensor,
    scale: Tensor,
    shift: Tensor,
    input_scale: int = 1,
    multiple: int = 4,
) -> Tensor:
    height, width = (-(-size * input_scale // multiple) * multiple for size in left.shape[:2])
    return mean.new_empty(2, bias_first.shape[0], height // 4, width // 4)


register_inference("stem", _fake_stem)
