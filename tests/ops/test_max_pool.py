"""max_pool against PyTorch's, an affine and ReLU."""

from __future__ import annotations

from typing import ClassVar

import pytest
import torch
from inference_operator import Call, InferenceOperator, call, random

import anynet_ext


def pool_call(*shape: int) -> Call:
    return lambda: call(random(*shape), random(shape[1]), random(shape[1]))


class TestMaxPool(InferenceOperator):
    op = "max_pool"
    tolerance: ClassVar = {"rtol": 1.3e-6, "atol": 1e-5}
    cases: ClassVar = {
        "x".join(map(str, shape)): pool_call(*shape)
        for shape in [(1, 2, 4, 4), (2, 3, 5, 3), (2, 3, 2, 2), (2, 3, 12, 70), (2, 4, 90, 300), (0, 2, 4, 4)]
    }
    errors: ClassVar = [
        (lambda: call(random(2, 4, 4), random(2), random(2)), "input as contiguous float32 tensor of 4 dimensions"),
        (
            lambda: call(random(1, 2, 4, 4).double(), random(2), random(2)),
            r"input as contiguous float32 tensor of 4 dimensions, got float64 \[1, 2, 4, 4\]$",
        ),
        (
            lambda: call(random(1, 2, 4, 4).mT, random(2), random(2)),
            r"tensor of 4 dimensions, got float32 \[1, 2, 4, 4\] of strides \[32, 16, 1, 4\]$",
        ),
        (lambda: call(random(1, 2, 4, 4), random(3), random(2)), r"scale of shape \[2\], got \[3\]"),
        (lambda: call(random(1, 2, 4, 4), random(2), random(1)), r"shift of shape \[2\], got \[1\]"),
    ]


def test_an_empty_result() -> None:
    assert anynet_ext.max_pool(random(1, 2, 1, 4), random(2), random(2)).shape == (1, 2, 0, 2)


@pytest.mark.parametrize("y", [0, 1])
@pytest.mark.parametrize("x", [0, 1])
def test_nan_is_kept(y: int, x: int) -> None:
    input = random(1, 1, 2, 4)
    input[0, 0, y, x] = torch.nan
    out = anynet_ext.max_pool(input, torch.ones(1), torch.zeros(1))
    assert out.isnan().tolist() == [[[[True, False]]]]
