"""refinement_guide against what it is made of."""

from __future__ import annotations

from typing import ClassVar

from inference_operator import Call, InferenceOperator, call, image, random


def guide_call(height: int, width: int, factor: int, block: int, image_size: tuple[int, int] | None = None) -> Call:
    images = image_size or (max(1, factor * height - 1), max(1, factor * width - factor // 2))
    disparity = 3 * random(1, 1, height, width).abs().sort(-1).values * factor
    return lambda: call(
        image(*images), image(*images, seed=1), disparity, random(3), random(3).abs() + 1, factor, block=block
    )


def wrong(factor: int = 2, block: int = 1, **changed: object) -> Call:
    names = ("left", "right", "disparity", "mean", "std")
    tensors = dict(zip(names, guide_call(4, 5, 2, 1)()[0], strict=False)) | changed
    return lambda: call(*tensors.values(), factor, block=block)


class TestRefinementGuide(InferenceOperator):
    op = "refinement_guide"
    tolerance: ClassVar = {"rtol": 1e-4, "atol": 1e-3}  # an image's values are up to some hundreds here
    cases: ClassVar = {
        f"{height}x{width}-{factor}-{block}": guide_call(height, width, factor, block)
        for height, width in [(4, 5), (2, 8), (1, 1), (7, 33), (23, 77)]
        for factor, block in [(4, 2), (4, 1), (2, 2), (2, 1), (1, 1)]
    } | {"images as they come": guide_call(5, 19, 4, 2, (3, 7))}
    errors: ClassVar = [
        (wrong(factor=3), "factor 1, 2 or 4, got 3"),
        (wrong(block=3), "block 1 or 2, at most the factor, got 3"),
        (wrong(factor=1, block=2), "block 1 or 2, at most the factor, got 2"),
        (wrong(left=image(8, 8)[0]), r"uint8 image of shape \[H, W, 3\], got uint8 \[8, 3\]"),
        (wrong(right=image(3, 3)), r"images of one size, got \[7, 9, 3\] and \[3, 3, 3\]"),
        (wrong(disparity=random(2, 1, 4, 5)), r"disparity of shape \[1, 1, H, W\], got \[2, 1, 4, 5\]"),
        (wrong(disparity=random(1, 1, 0, 5)), "at least one pixel"),
        (wrong(mean=random(2)), r"mean of shape \[3\], got \[2\]"),
        (wrong(std=random(4)), r"std of shape \[3\], got \[4\]"),
    ]
