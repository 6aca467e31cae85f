"""The candidates of a residual stage: their matching costs, and the disparity expected under these."""

from __future__ import annotations

import torch
from torch import Tensor

from anynet_ext import _library  # noqa: F401  (loads the operators)
from anynet_ext._register import overridable, register_inference


@overridable
def candidate_costs(features: Tensor, disparity: Tensor, groups: int, first: int, last: int, radius: int) -> Tensor:
    """Matching costs of a residual stage's candidates, with what else its network sees. For inference.

    The candidates are the residuals first ... last around the estimate and, to propagate good disparities, the largest
    and the smallest disparity of a window.

    Args:
        features: [2, C, H, W] float32, contiguous: of the left and the right image.
        disparity: [1, 1, H, W] float32, contiguous, finite, in the features' pixels.
        groups: of channels, each with costs of its own.
        first, last: the range of residuals in pixels, both included.
        radius: of the window, 0 to 1024 pixels.

    Returns:
        [1, groups * (last - first + 3) + C + 2, H, W]: each group's costs of the residuals, of the largest
        disparity, and of the smallest; the left features; the largest and the smallest as residuals.

    Raises:
        RuntimeError: if an argument has the wrong dtype, shape, layout or value.

    Source: the candidates follow PatchMatch stereo (Bleyer et al., BMVC 2011).
    """
    out: Tensor = torch.ops.anynet.candidate_costs(features, disparity, groups, first, last, radius)
    return out


@overridable
def expected_disparity(cost: Tensor, disparity: Tensor, offsets: Tensor, first: int) -> Tensor:
    """`disparity + sum_k softmax(-cost)[k] * residual[k]`, for inference.

    The residuals are first, first + 1, ..., offsets[:, 0], offsets[:, 1], as `candidate_costs` orders them.

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


def _fake_candidate_costs(
    features: Tensor, disparity: Tensor, groups: int, first: int, last: int, radius: int
) -> Tensor:
    _, c, h, w = features.shape
    return features.new_empty(1, groups * (last - first + 3) + c + 2, h, w)


def _fake_expected_disparity(cost: Tensor, disparity: Tensor, offsets: Tensor, first: int) -> Tensor:
    return torch.empty_like(disparity, memory_format=torch.contiguous_format)


register_inference("candidate_costs", _fake_candidate_costs)
register_inference("expected_disparity", _fake_expected_disparity)
