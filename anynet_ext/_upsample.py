"""Upsampling fused with what follows it: sums of maps, skip connections."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from anynet_ext import _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register_inference, register_out


@overridable
def upsample_sum(
    maps: Sequence[Tensor],
    ratios: Sequence[int],
    height: int,
    width: int,
    *,
    gains: Sequence[float] = (),
    side: float = 0.0,
    out: Tensor | None = None,
) -> Tensor:
    """Maps upsampled to one size, and added: `sum_i gains[i] * bilinear(maps[i])`, for inference.

    Interpolation is PyTorch's with align_corners=False, by `ratios[i]` (a power of two) in both directions; the result
    is cropped to its top left `height` x `width`.

    Args:
        maps: 1 to 8, each [H_i, W_i] float32, contiguous, with ratios[i] * H_i >= height, and likewise across.
        gains: one per map; none: 1 each.
        side: if not 0, the last map, of ratio 1, is smoothed first: along both axes, each value becomes 1 - 2 side of
            itself and `side` of both its neighbors, the border being its own. At most 0.5.
        out: [height, width] float32, contiguous, apart from the maps in memory: where to write the result.

    Returns:
        [height, width] float32; `out` if it is given.

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape, or `out` or a map beside it requires gradients.
    """
    terms = list(maps), list(ratios), list(gains), side
    if out is None:
        result: Tensor = torch.ops.anynet.upsample_sum(*terms, height, width)
        return result
    if not isinstance(out, Tensor) or tuple(out.shape) != (height, width):
        came = list(out.shape) if isinstance(out, Tensor) else type(out).__name__
        raise RuntimeError(f"upsample_sum: expected out of shape [{height}, {width}], got {came}")
    torch.ops.anynet.upsample_sum.out(*terms, out=out)
    return out


@overridable
def upsample_concat(skip: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """`relu(scale * cat([skip, upsampled coarse]) + shift)`: a U-Net's skip connection and the next epilogue.

    Bilinear with align_corners=True. For inference.

    Args:
        skip: [N, S, H, W] float32, contiguous, as are all.
        coarse: [N, C, h, w].
        scale, shift: [S + C].

    Returns:
        [N, S + C, H, W].

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.
    """
    out: Tensor = torch.ops.anynet.upsample_concat(skip, coarse, scale, shift)
    return out


@overridable
def upsample_add(input: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """`relu(scale * (input + upsampled coarse) + shift)`: an hourglass's skip connection and the next epilogue.

    Trilinear with align_corners=False. For inference.

    Args:
        input: [N, C, D, H, W] float32, contiguous, as are all.
        coarse: [N, C, d, h, w].
        scale, shift: [C].

    Returns:
        [N, C, D, H, W].

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.
    """
    out: Tensor = torch.ops.anynet.upsample_add(input, coarse, scale, shift)
    return out


def _fake_upsample_sum(
    maps: list[Tensor], ratios: list[int], gains: list[float], side: float, height: int, width: int
) -> Tensor:
    return maps[0].new_empty(height, width)


def _fake_upsample_sum_out(
    maps: list[Tensor], ratios: list[int], gains: list[float], side: float, *, out: Tensor
) -> None:
    pass


def _fake_upsample_concat(skip: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    n, _, h, w = skip.shape
    return skip.new_empty(n, skip.shape[1] + coarse.shape[1], h, w)


def _fake_upsample_add(input: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    return torch.empty_like(input, memory_format=torch.contiguous_format)


register_inference("upsample_sum", _fake_upsample_sum)
register_out("upsample_sum", _fake_upsample_sum_out)
register_inference("upsample_concat", _fake_upsample_concat)
register_inference("upsample_add", _fake_upsample_add)
