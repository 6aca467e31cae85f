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
    input_scale: int = 1,
    multiple: int = 4,
) -> Tensor:
    """AnyNet's first layers on images in bytes, in one pass without intermediate tensors.

    Both images, less `mean`, go through a 3x3 convolution, ReLU, a 3x3 convolution with stride 2, 2x2 max pooling, a
    per-channel affine, and ReLU. Before that they are enlarged (bilinear, align_corners=False) and extended at the
    right and the bottom by repeating their last column and row, to sizes that `multiple` divides; the convolutions'
    own padding is zeros.

    Args:
        left, right: [H, W, 3] uint8, contiguous.
        mean: [3] float32, as are all that follow; in the images' units.
        weight_first, bias_first: [C, 3, 3, 3], [C].
        weight_second: [C, C, 3, 3].
        scale, shift: [C].
        input_scale: 1 or 2, how many times as high and wide to make the images first.
        multiple: a multiple of 4.

    Returns:
        [2, C, H' / 4, W' / 4] float32, H' and W' the enlarged and extended size.

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.

    Source: AnyNet paper (arXiv 1810.11408), Table I.
    """
    out: Tensor = torch.ops.anynet.stem(
        left, right, mean, weight_first, bias_first, weight_second, scale, shift, input_scale, multiple
    )
    return out


def upsample_sum(
    maps: Sequence[Tensor], ratios: Sequence[int], height: int, width: int, *, gain: float = 1.0
) -> Tensor:
    """Small maps enlarged to one size, and added: `gain * sum_i bilinear(maps[i])`.

    Interpolation is PyTorch's with align_corners=False, map i being enlarged `ratios[i]` times (a power of two)
    in both directions; of the result, the top left `height` x `width`.

    Args:
        maps: 1 to 8, each [H_i, W_i] float32, contiguous, with ratios[i] * H_i >= height, and likewise across.

    Returns:
        [height, width] float32.

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.
    """
    out: Tensor = torch.ops.anynet.upsample_sum(list(maps), list(ratios), gain, height, width)
    return out


def upsample_concat(skip: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """`relu(scale * cat([skip, enlarged coarse]) + shift)`: a U-Net's way up, as far as its next convolution.

    Enlarging is bilinear with align_corners=True.

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


def upsample_add(input: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """`relu(scale * (input + enlarged coarse) + shift)`: an hourglass's way up, as far as its next convolution.

    Enlarging is trilinear with align_corners=False.

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


def cost_volume_affine_relu(
    left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int, scale: Tensor, shift: Tensor
) -> Tensor:
    """`relu(scale * cost_volume + shift)`: as far as the disparity network's first convolution.

    Args:
        left: [N, C, H, W] float32, contiguous; the G groups of channels of a pair go as so many pairs.
        right: [N, C, H, W] float32.
        disparity: [N, 1, H, W] or None.
        first, last: the offsets to compare at.
        scale, shift: [G], for pair n those at n % G.

    Returns:
        [N, last - first + 1, H, W].

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.
    """
    out: Tensor = torch.ops.anynet.cost_volume_affine_relu(left, right, disparity, first, last, scale, shift)
    return out


def max_pool(input: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """`relu(scale * max_pool2x2(input) + shift)`: [N, C, H, W], [C], [C] -> [N, C, H // 2, W // 2], float32."""
    out: Tensor = torch.ops.anynet.max_pool(input, scale, shift)
    return out


def normalized_propagation(input: Tensor, gates: Tensor, direction: int) -> Tensor:
    """`spatial_propagation` with gates over the sum of the absolute values of each pixel's three, plus 1e-8.

    [N, C, H, W], [N, 3, C, H, W] -> [N, C, H, W], float32, contiguous.

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape or layout, or the direction is not 0, 1, 2 or 3.
    """
    out: Tensor = torch.ops.anynet.normalized_propagation(input, gates, direction)
    return out


def fill_occlusions(disparity: Tensor, pixel: float) -> Tensor:
    """Disparity with what it hides from the right camera filled from the background beside it.

    What lies beyond the right image's left border takes the disparity of its right neighbour, what lies behind
    something nearer, that of its left one, pixel after pixel. Hidden by less than two pixels, it takes a part of it.

    Args:
        disparity: [N, 1, H, W] float32, contiguous, finite.
        pixel: how much of its unit one column is.

    Returns:
        [N, 1, H, W].

    Raises:
        RuntimeError: if an argument has the wrong dtype, layout or value.
    """
    out: Tensor = torch.ops.anynet.fill_occlusions(disparity, pixel)
    return out


def candidate_costs(features: Tensor, disparity: Tensor, groups: int, first: int, last: int, radius: int) -> Tensor:
    """What a residual stage's network looks at (`anynet.network.Update`).

    Args:
        features: [2, C, H, W] float32, contiguous: of the left image and the right one.
        disparity: [1, 1, H, W] float32, contiguous, finite, in the features' pixels.
        groups: of channels that are compared, each with costs of its own.
        first, last: residuals to test.
        radius: rows and columns within which the nearest and the farthest disparity are tested too.

    Returns:
        [1, groups * (last - first + 3) + C + 2, H, W]: each group's costs of the residuals, each group's of the
        nearest disparity, and of the farthest; the left features; the nearest and the farthest as residuals.

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape, layout or value.
    """
    out: Tensor = torch.ops.anynet.candidate_costs(features, disparity, groups, first, last, radius)
    return out


def expected_disparity(cost: Tensor, disparity: Tensor, offsets: Tensor, first: int) -> Tensor:
    """disparity + sum of softmax(-cost) times the residuals first, first + 1, ..., offsets[:, 0], offsets[:, 1].

    Args:
        cost: [1, K, H, W] float32, contiguous, K >= 2.
        disparity: [1, 1, H, W] float32, contiguous.
        offsets: [1, 2, H, W] float32, contiguous.
        first: residual of the first cost.

    Returns:
        [1, 1, H, W].

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape or layout.
    """
    out: Tensor = torch.ops.anynet.expected_disparity(cost, disparity, offsets, first)
    return out


def convex_upsampling(input: Tensor, logits: Tensor) -> Tensor:
    """Twice the size, each pixel a mean of the nine around it, weighted by a softmax (RAFT, arXiv 2003.12039, 3.3).

    Args:
        input: [N, 1, H, W] float32, contiguous; beyond its border lies the border's value.
        logits: [N, 32, H, W] float32, contiguous: of the four pixels that one becomes, row by row, those of its eight
            neighbours, row by row; its own is 0.

    Returns:
        [N, 1, 2H, 2W].

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape or layout.
    """
    out: Tensor = torch.ops.anynet.convex_upsampling(input, logits)
    return out


def read_image(
    image: Tensor, mean: Tensor, std: Tensor, factor: int, height: int, width: int, *, block: int = 1
) -> Tensor:
    """An image in bytes made `factor` times smaller, bilinear (align_corners=False), less `mean`, over `std`.

    Args:
        image: [H, W, 3] uint8, contiguous; extended by its last row and column where the output goes beyond.
        mean, std: [3] float32, in the image's units.
        factor: 1, 2 or 4.
        block: 1 or 2: blocks of so many by so many pixels become as many channels (`pixel_unshuffle`).

    Returns:
        [1, 3 block^2, height, width] float32.

    Raises:
        RuntimeError: if an argument has the wrong dtype or shape.
    """
    out: Tensor = torch.ops.anynet.read_image(image, mean, std, factor, block, height, width)
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
    input_scale: int,
    multiple: int,
) -> Tensor:
    height, width = (-(-size * input_scale // multiple) * multiple for size in left.shape[:2])
    return mean.new_empty(2, bias_first.shape[0], height // 4, width // 4)


def _fake_upsample_sum(maps: list[Tensor], ratios: list[int], gain: float, height: int, width: int) -> Tensor:
    return maps[0].new_empty(height, width)


def _fake_upsample_concat(skip: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    n, _, h, w = skip.shape
    return skip.new_empty(n, skip.shape[1] + coarse.shape[1], h, w)


def _fake_upsample_add(input: Tensor, coarse: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    return torch.empty_like(input, memory_format=torch.contiguous_format)


def _fake_cost_volume_affine_relu(
    left: Tensor, right: Tensor, disparity: Tensor | None, first: int, last: int, scale: Tensor, shift: Tensor
) -> Tensor:
    n, _, h, w = left.shape
    return left.new_empty(n, last - first + 1, h, w)


def _fake_max_pool(input: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    n, c, h, w = input.shape
    return input.new_empty(n, c, h // 2, w // 2)


def _fake_normalized_propagation(input: Tensor, gates: Tensor, direction: int) -> Tensor:
    return torch.empty_like(input, memory_format=torch.contiguous_format)


def _fake_fill_occlusions(disparity: Tensor, pixel: float) -> Tensor:
    return torch.empty_like(disparity, memory_format=torch.contiguous_format)


def _fake_candidate_costs(
    features: Tensor, disparity: Tensor, groups: int, first: int, last: int, radius: int
) -> Tensor:
    _, c, h, w = features.shape
    return features.new_empty(1, groups * (last - first + 3) + c + 2, h, w)


def _fake_expected_disparity(cost: Tensor, disparity: Tensor, offsets: Tensor, first: int) -> Tensor:
    return torch.empty_like(disparity, memory_format=torch.contiguous_format)


def _fake_convex_upsampling(input: Tensor, logits: Tensor) -> Tensor:
    n, _, h, w = input.shape
    return input.new_empty(n, 1, 2 * h, 2 * w)


def _fake_read_image(
    image: Tensor, mean: Tensor, std: Tensor, factor: int, block: int, height: int, width: int
) -> Tensor:
    return mean.new_empty(1, 3 * block**2, height, width)


def _no_gradient(*_: object) -> None:
    raise RuntimeError("the operators of the inference graph have no gradients")


for _fake in (
    _fake_stem,
    _fake_upsample_sum,
    _fake_upsample_concat,
    _fake_upsample_add,
    _fake_cost_volume_affine_relu,
    _fake_max_pool,
    _fake_normalized_propagation,
    _fake_fill_occlusions,
    _fake_candidate_costs,
    _fake_expected_disparity,
    _fake_convex_upsampling,
    _fake_read_image,
):
    _name = "anynet::" + _fake.__name__.removeprefix("_fake_")
    torch.library.register_fake(_name, _fake)
    torch.library.register_autograd(_name, _no_gradient)
