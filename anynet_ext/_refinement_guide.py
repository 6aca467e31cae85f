"""What steers the refinement of a disparity map."""

from __future__ import annotations

import torch
from torch import Tensor

from anynet_ext import _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register_inference


@overridable
def refinement_guide(
    left: Tensor, right: Tensor, disparity: Tensor, mean: Tensor, std: Tensor, factor: int, *, block: int = 1
) -> Tensor:
    """The left image, how the right one, warped, differs from it, and the disparity, at its resolution. For inference.

    `read_image(left, ..., factor // block, block=block)`, then `warp(read_image(right, ..., factor), d)` less the left
    one, then d, the disparity over `factor`.

    Args:
        left, right: [H, W, 3] uint8, contiguous; padded by replication where the disparity goes beyond.
        disparity: [1, 1, h, w] float32, contiguous, in pixels of the images.
        mean, std: [3] float32, in 8-bit units.
        factor: 1, 2 or 4: how much larger the images are.
        block: 1 or 2, at most `factor`: the left image comes at so many times the resolution, in blocks of pixels that
            are channels.

    Returns:
        [1, 3 block^2 + 4, h, w] float32.

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape or layout.
    """
    out: Tensor = torch.ops.anynet.refinement_guide(left, right, disparity, mean, std, factor, block)
    return out


def _fake_refinement_guide(
    left: Tensor, right: Tensor, disparity: Tensor, mean: Tensor, std: Tensor, factor: int, block: int
) -> Tensor:
    return disparity.new_empty(1, 3 * block**2 + 4, *disparity.shape[2:])


register_inference("refinement_guide", _fake_refinement_guide)
