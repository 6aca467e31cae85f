"""stem against PyTorch's layers."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
import torch
from inference_operator import Call, InferenceOperator, call, image, random
from torch import Tensor

import anynet_ext
from anynet_ext import reference

SIZES = [(8, 8), (5, 7), (1, 1), (4, 4), (32, 64), (37, 130), (64, 273)]


def stem_call(height: int, width: int, channels: int = 2, **options: int) -> Call:
    def make() -> tuple[tuple[Any, ...], dict[str, Any]]:
        images = image(height, width), image(height, width, seed=1)
        first = 100 + random(3), random(channels, 3, 3, 3) / 100, random(channels)
        second = random(channels, channels, 3, 3), random(channels), random(channels)
        return call(*images, *first, *second, **options)

    return make


def replaced(index: int, value: Tensor, **options: int) -> Call:
    def make() -> tuple[tuple[Any, ...], dict[str, Any]]:
        args, _ = stem_call(8, 8)()
        return call(*args[:index], value, *args[index + 1 :], **options)

    return make


class TestStem(InferenceOperator):
    op = "stem"
    tolerance: ClassVar = {"rtol": 1e-4, "atol": 1e-4}
    cases: ClassVar = {
        f"{height}x{width}x{channels}-{multiple}-{scale}": stem_call(
            height, width, channels, multiple=multiple, input_scale=scale
        )
        for height, width in SIZES
        for channels in (1, 3)
        for multiple in (4, 16)
        for scale in (1, 2)
    }
    errors: ClassVar = [
        (replaced(1, image(8, 9)), r"images of one size, got \[8, 8, 3\] and \[8, 9, 3\]"),
        (
            replaced(0, image(8, 8)[..., 0]),
            r"contiguous uint8 image of shape \[H, W, 3\], got uint8 \[8, 8\] of strides \[24, 3\]",
        ),
        (replaced(0, image(8, 8).char()), r"contiguous uint8 image of shape \[H, W, 3\], got int8 \[8, 8, 3\]$"),
        (replaced(5, random(1, 1, 3, 3)), r"weight_second of shape \[2, 2, 3, 3\], got \[1, 1, 3, 3\]"),
        (stem_call(8, 8, input_scale=3), "input_scale 1 or 2, got 3"),
        (stem_call(8, 8, multiple=6), "multiple of 4, at most 65536, got 6"),
        (stem_call(8, 8, multiple=2**62), "multiple of 4, at most 65536, got 4611686018427387904"),
    ]


PARAMETERS = ("mean", "weight_first", "bias_first", "weight_second", "scale", "shift")


@pytest.mark.parametrize("name", PARAMETERS)
def test_nan_is_kept(name: str) -> None:
    args, _ = stem_call(16, 24)()
    args[2 + PARAMETERS.index(name)].fill_(torch.nan)
    assert anynet_ext.stem(*args).isnan().all()


@pytest.mark.parametrize("name", PARAMETERS)
def test_cuda_keeps_nan(cuda: Any, name: str) -> None:
    args, _ = stem_call(16, 24)()
    args[2 + PARAMETERS.index(name)].fill_(torch.nan)
    stem = getattr(torch.ops, cuda.namespace).stem
    assert stem(*[t.to(cuda.device) for t in args]).isnan().all()


@pytest.mark.parametrize("y", range(4))
@pytest.mark.parametrize("x", range(4))
def test_nan_is_kept_whichever_pooled_value_it_is(y: int, x: int) -> None:
    """One pixel is infinite after the first layer, and so NaN after the second, where that sees it."""
    (left, *rest), _ = stem_call(8, 8, channels=1)()
    args = [torch.zeros_like(left), *[torch.zeros_like(t) for t in rest]]
    args[0][y, x] = 255
    args[3][0, 0, 1, 1] = 3e38
    assert 0 < reference.stem(*args).isnan().sum() < 8
    assert anynet_ext.stem(*args).isnan().equal(reference.stem(*args).isnan())
