"""convex_upsampling against a softmax over the 3x3 around each pixel."""

from __future__ import annotations

from typing import ClassVar

import torch
import torch.nn.functional as F
from inference_operator import Call, InferenceOperator, call, random
from torch import Tensor

import anynet_ext
from anynet_ext import reference


def logits(*shape: int) -> Tensor:
    result = 3 * random(*shape)
    result[..., ::3] *= 100  # one neighbor alone
    return result


def convex_call(n: int, *size: int) -> Call:
    return lambda: call(random(n, 1, *size), logits(n, 32, *size))


class TestConvexUpsampling(InferenceOperator):
    op = "convex_upsampling"
    cases: ClassVar = {
        f"{shape}": convex_call(*shape)
        for shape in [(2, 4, 5), (1, 1, 1), (2, 5, 70), (1, 3, 16), (1, 40, 33), (0, 4, 4)]
    }
    errors: ClassVar = [
        (lambda: call(random(1, 2, 2, 2), random(1, 32, 2, 2)), r"input of shape \[1, 1, 2, 2\], got \[1, 2, 2, 2\]"),
        (
            lambda: call(random(1, 1, 2, 2), random(1, 36, 2, 2)),
            r"logits of shape \[1, 32, 2, 2\], got \[1, 36, 2, 2\]",
        ),
        (lambda: call(random(1, 2, 2), random(1, 32, 2, 2)), "input as contiguous float32 tensor of 4 dimensions"),
    ]


def test_an_empty_map() -> None:
    assert anynet_ext.convex_upsampling(random(1, 1, 0, 4), random(1, 32, 0, 4)).shape == (1, 1, 0, 8)


def test_the_reference_has_gradients() -> None:
    tensors = [t.double().requires_grad_() for t in (random(2, 1, 3, 4), random(2, 32, 3, 4))]
    assert torch.autograd.gradcheck(reference.convex_upsampling, tensors)


def test_takes_what_the_logits_say() -> None:
    x = torch.arange(20.0).view(1, 1, 4, 5)
    weights = torch.zeros(1, 4, 8, 4, 5)
    weights[:, 1, 4] = 100  # the upper right one of the four: the right neighbor
    weights[:, 2, 1] = 100  # the lower left one: the one above
    weights[:, 3] = -100  # the lower right one: itself
    around = F.avg_pool2d(F.pad(x, (1, 1, 1, 1), mode="replicate"), 3, 1)
    for module in (anynet_ext, reference):
        out = module.convex_upsampling(x, weights.view(1, 32, 4, 5))
        torch.testing.assert_close(out[..., ::2, 1::2], torch.cat([x[..., 1:], x[..., -1:]], 3))
        torch.testing.assert_close(out[..., 1::2, ::2], torch.cat([x[..., :1, :], x[..., :-1, :]], 2))
        torch.testing.assert_close(out[..., 1::2, 1::2], x)
        torch.testing.assert_close(out[..., ::2, ::2], around)
