"""8-bit images, downsampled and normalized."""

from __future__ import annotations

import torch
from torch import Tensor

from anynet_ext import _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register_inference


@overridable
def read_image(
    image: Tensor, mean: Tensor, std: Tensor, factor: int, height: int, width: int, *, block: int = 1
) -> Tensor:
    """An 8-bit image downsampled by `factor` (bilinear, align_corners=False) and normalized: less `mean`, over `std`.

    For inference.

    Args:
        image: [H, W, 3] uint8, contiguous; padded by replication where the output goes beyond.
        mean, std: [3] float32, in 8-bit units.
        factor: 1, 2 or 4.
        block: 1 or 2: blocks of block x block pixels become channels (`pixel_unshuffle`).

    Returns:
        [1, 3 block^2, height, width] float32.

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.
    """
    out: Tensor = torch.ops.anynet.read_image(image, mean, std, factor, block, height, width)
    return out


def _fake_read_image(
    image: Tensor, mean: Tensor, std: Tensor, factor: int, block: int, height: int, width: int
) -> Tensor:
    return mean.new_empty(1, 3 * block**2, height, width)


register_inference("read_image", _fake_read_image)
