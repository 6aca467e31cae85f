"""upsample_sum, upsample_concat and upsample_add against `interpolate`."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
import torch
from inference_operator import Call, InferenceOperator, call, random

import anynet_ext
from anynet_ext import reference

RATIOS = [16, 8, 4, 2, 1]


def sum_call(height: int, width: int, crop: int) -> Call:
    def make() -> tuple[tuple[Any, ...], dict[str, Any]]:
        maps = [random(height * 16 // ratio, width * 16 // ratio) for ratio in RATIOS]
        gains = [1 / 8, 3.0, -1.0, 0.5, 2.0]
        side = {} if crop else {"side": 1 / 8}
        return call(maps, RATIOS, 16 * height - crop, 16 * width - crop, gains=gains, **side)

    return make


class TestUpsampleSum(InferenceOperator):
    op = "upsample_sum"
    cases: ClassVar = {
        f"{height}x{width}-{crop}": sum_call(height, width, crop)
        for height, width in [(1, 1), (1, 2), (3, 1), (2, 5), (5, 37)]
        for crop in (0, 3)
    }
    errors: ClassVar = [
        (lambda: call([random(2, 2)], [4], 9, 8), r"maps that cover 9 x 8, got \[2, 2\] times 4"),
        (lambda: call([random(2, 2)], [4], 8, 9), r"maps that cover 8 x 9, got \[2, 2\] times 4"),
        (lambda: call([random(2, 2)], [3], 6, 6), "power of two, got 3"),
        (lambda: call([random(2, 2)], [-4], 6, 6), "power of two, got -4"),
        (
            lambda: call([random(2, 2)] * 9, [4] * 9, 8, 8),
            "1 to 8 maps, as many ratios, .* got 9, 9 and 0",
        ),
        (
            lambda: call([random(2, 2)], [4, 4], 8, 8),
            "1 to 8 maps, as many ratios, .* got 1, 2 and 0",
        ),
        (lambda: call([random(2, 2)], [4], 8, 8, gains=[1.0, 1.0]), "as many gains or none, got 1, 1 and 2"),
        (lambda: call([random(2, 2)], [4], 8, 8, side=0.25), "0 if the last ratio is not 1, got 0.25"),
        (lambda: call([random(2, 2)], [1], 2, 2, side=0.6), "side 0 to 0.5.* got 0.6"),
        (lambda: call([random(2, 2)], [1], 2, 2, side=float("nan")), "side 0 to 0.5.* got nan"),
        (lambda: call([random(2, 2)], [4], 0, 8), "at least one pixel and at most .* got 0 x 8"),
        (lambda: call([random(2, 2)], [2**62], 2**40, 1), "at most 2\\^30 along each side, got 1099511627776 x 1"),
        (lambda: call([random(2, 0)], [2**62], 1, 1), r"maps that cover 1 x 1, got \[2, 0\]"),
    ]


def test_a_sum_into_memory_that_is_given() -> None:
    args, options = TestUpsampleSum.cases["5x37-3"]()
    expected = anynet_ext.upsample_sum(*args, **options)
    for module in (reference, anynet_ext):
        out = torch.full_like(expected, torch.nan)
        assert module.upsample_sum(*args, **options, out=out) is out
        torch.testing.assert_close(out, expected, **TestUpsampleSum.tolerance)
    assert torch.equal(out, expected)
    version = out._version
    anynet_ext.upsample_sum(*args, **options, out=out)
    assert out._version > version  # backward sees that it was written to
    parameter = torch.ones_like(out).requires_grad_()
    for maps, memory in (([args[0][0].requires_grad_(), *args[0][1:]], out), (args[0], parameter * 1)):
        with pytest.raises(RuntimeError, match="expected out and maps that do not require gradients"):
            anynet_ext.upsample_sum(maps, *args[1:], **options, out=memory)
    args[0][0].requires_grad_(False)
    with pytest.raises(RuntimeError, match="out apart from the maps in memory, got a part of number 1"):
        anynet_ext.upsample_sum([out.clone(), out], [1, 1], *out.shape, out=out)
    for wrong in (out.double(), out.t().contiguous().t(), out[None], out.to("meta")):
        with pytest.raises(RuntimeError, match=r"upsample_sum.*: expected (out|all tensors on one device)"):
            anynet_ext.upsample_sum(*args, **options, out=wrong)
    with pytest.raises(RuntimeError, match=r"upsample_sum: expected out of shape \[77, 589\], got list"):
        anynet_ext.upsample_sum(*args, **options, out=[1])


@pytest.mark.parametrize("ratio", [2**40, 2**62])
def test_a_ratio_far_beyond_the_result(ratio: int) -> None:
    """Takes neither the memory of what is cropped nor a product that overflows."""
    out = anynet_ext.upsample_sum([torch.tensor([[3.0, 5.0]])], [ratio], 16, 300)
    assert torch.equal(out, torch.full((16, 300), 3.0))


def concat_call(size: tuple[int, int], coarse: tuple[int, int]) -> Call:
    return lambda: call(random(2, 3, *size), random(2, 4, *coarse), random(7), random(8)[1:].clone())


class TestUpsampleConcat(InferenceOperator):
    op = "upsample_concat"
    cases: ClassVar = {
        f"{size}-{coarse}": concat_call(size, coarse)
        for size in [(2, 2), (1, 1), (7, 19), (10, 64), (60, 200)]
        for coarse in [(1, 1), (1, 3), (4, 10), (5, 32)]
    }
    errors: ClassVar = [
        (
            lambda: call(random(1, 2, 4, 4), random(1, 1, 2, 2), random(2), random(2)),
            r"scale of shape \[3\], got \[2\]",
        ),
        (lambda: call(random(2, 2, 4, 4), random(1, 1, 2, 2), random(3), random(3)), "coarse of skip's batch size"),
        (lambda: call(random(1, 2, 4, 4), random(1, 1, 0, 2), random(3), random(3)), "at least one pixel"),
    ]


def test_empty_results() -> None:
    skip, volume = random(2, 3, 0, 4), random(2, 3, 2, 0, 3)
    assert anynet_ext.upsample_concat(skip, random(2, 4, 2, 2), random(7), random(7)).shape == (2, 7, 0, 4)
    assert anynet_ext.upsample_add(volume, random(2, 3, 1, 1, 1), random(3), random(3)).shape == volume.shape
    none = random(0, 3, 4, 4)  # images
    assert anynet_ext.upsample_concat(none, random(0, 4, 2, 2), random(7), random(7)).shape == (0, 7, 4, 4)
    for batch, channels in ((0, 3), (2, 0)):
        volume = random(batch, channels, 2, 4, 4)
        coarse = random(batch, channels, 1, 2, 2)
        assert anynet_ext.upsample_add(volume, coarse, random(channels), random(channels)).shape == volume.shape


def add_call(size: tuple[int, int, int], coarse: tuple[int, int, int]) -> Call:
    return lambda: call(random(2, 3, *size), random(2, 3, *coarse), random(3), random(4)[1:].clone())


class TestUpsampleAdd(InferenceOperator):
    op = "upsample_add"
    cases: ClassVar = {
        f"{size}-{coarse}": add_call(size, coarse)
        for size in [(2, 2, 3), (1, 1, 1), (5, 7, 19), (4, 10, 64), (6, 30, 90)]
        for coarse in [(1, 1, 1), (3, 1, 2), (2, 5, 32)]
    }
    errors: ClassVar = [
        (
            lambda: call(random(1, 2, 2, 4, 4), random(1, 3, 1, 2, 2), random(2), random(2)),
            r"coarse of input's batch size and channels.* got \[1, 3, 1, 2, 2\]",
        ),
        (lambda: call(random(1, 2, 2, 4, 4), random(1, 2, 1, 2, 2), random(3), random(2)), r"scale of shape \[2\]"),
        (lambda: call(random(2, 2, 4, 4), random(1, 2, 1, 2, 2), random(2), random(2)), "tensor of 5 dimensions"),
    ]


@pytest.mark.parametrize("compiled", [False, True])
def test_backward_notices_that_out_was_written_to(compiled: bool) -> None:
    def loss(factor: torch.Tensor, maps: torch.Tensor, out: torch.Tensor) -> torch.Tensor:
        total = (factor * out).sum()
        torch.ops.anynet.upsample_sum.out([maps], [1], [], 0.0, out=out)
        return total

    if compiled:
        loss = torch.compile(loss, fullgraph=True, backend="aot_eager")
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):  # compiled, from the call on
        loss(torch.ones(4, 4, requires_grad=True), torch.zeros(4, 4), torch.ones(4, 4)).backward()


def test_out_is_for_inference() -> None:
    def call(maps: torch.Tensor) -> torch.Tensor:
        out = torch.zeros(4, 4)
        torch.ops.anynet.upsample_sum.out([maps], [1], [], 0.0, out=out)
        return out

    with pytest.raises(RuntimeError, match="expected out and maps that do not require gradients"):
        call(torch.ones(4, 4, requires_grad=True))
    with pytest.raises(NotImplementedError, match="forward-mode derivatives are not supported"):
        torch.func.jvp(call, (torch.ones(4, 4),), (torch.ones(4, 4),))
    with torch.inference_mode():
        out = torch.zeros(4, 4)
    anynet_ext.upsample_sum([torch.ones(4, 4)], [1], 4, 4, out=out)  # such memory has no versions
    assert out.sum() == 16
