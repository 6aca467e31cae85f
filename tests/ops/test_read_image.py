"""read_image against `interpolate` and `pixel_unshuffle`."""

from __future__ import annotations

from typing import ClassVar

from inference_operator import Call, InferenceOperator, call, image, random


def read_call(height: int, width: int, factor: int, block: int) -> Call:
    size = -(-height // (factor * block)), -(-width // (factor * block))
    return lambda: call(image(height, width), random(3), random(3).abs() + 1, factor, *size, block=block)


def wrong(factor: int, height: int, width: int, block: int = 1) -> Call:
    return lambda: call(image(8, 8), random(3), random(3), factor, height, width, block=block)


class TestReadImage(InferenceOperator):
    op = "read_image"
    tolerance: ClassVar = {"rtol": 1e-4, "atol": 1e-4}
    cases: ClassVar = {
        f"{height}x{width}-{factor}-{block}": read_call(height, width, factor, block)
        for height, width in [(4, 4), (16, 20), (1, 1), (37, 61), (150, 420)]
        for factor in (4, 1, 2)
        for block in (1, 2)
    }
    errors: ClassVar = [
        (wrong(4, 0, 2), "at least one pixel and at most 2\\^30 along each side, got 0 x 2"),
        (wrong(4, 2**62, 2), "at most 2\\^30 along each side, got 4611686018427387904 x 2"),
        (wrong(3, 2, 2), "factor 1, 2 or 4, got 3"),
        (wrong(1, 2, 2, block=3), "block 1 or 2, got 3"),
        (
            lambda: call(image(8, 8)[0], random(3), random(3), 1, 8, 8),
            r"uint8 image of shape \[H, W, 3\], got uint8 \[8, 3\]",
        ),
        (lambda: call(image(8, 8), random(2), random(3), 1, 8, 8), r"mean of shape \[3\], got \[2\]"),
    ]
