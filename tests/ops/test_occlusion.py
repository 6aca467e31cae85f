"""fill_occlusions against the scans that it fuses."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
import torch
from inference_operator import Call, InferenceOperator, call, random
from torch import Tensor

import anynet_ext
from anynet_ext import reference


def map_of_surfaces(*shape: int) -> Tensor:
    steps = (random(*shape) > 1).float() * 20 * random(*shape[:3], 1).abs()
    return 10 + random(*shape) + steps


def fill_call(pixel: float, *shape: int) -> Call:
    return lambda: call(pixel * map_of_surfaces(*shape), pixel)


class TestFillOcclusions(InferenceOperator):
    op = "fill_occlusions"
    tolerance: ClassVar = {"rtol": 1e-4, "atol": 1e-4}
    cases: ClassVar = {
        f"{shape}-{pixel}": fill_call(pixel, *shape)
        for shape in [(1, 1, 4, 30), (1, 1, 1, 1), (2, 1, 5, 70), (1, 1, 90, 300), (0, 1, 4, 4), (1, 1, 3, 0)]
        for pixel in (1.0, 4.0)
    }
    errors: ClassVar = [
        (lambda: call(random(3, 4), 1.0), "disparity as contiguous float32 tensor of 4 dimensions"),
        (lambda: call(random(1, 1, 3, 4), 0.0), "finite pixel above 0, got 0"),
        (lambda: call(random(1, 1, 3, 4), -1.0), "finite pixel above 0, got -1"),
        (lambda: call(random(1, 1, 3, 4), float("nan")), "finite pixel above 0, got nan"),
        (lambda: call(random(1, 1, 3, 4), float("inf")), "finite pixel above 0, got inf"),
        (lambda: call(random(1, 1, 3, 4), 1e-300), "as float32 a finite pixel above 0, got 1e-300"),
        (lambda: call(random(1, 1, 3, 4), 1e300), "as float32 a finite pixel above 0, got 1e\\+300"),
    ]


def scene() -> tuple[Tensor, Tensor]:
    """A wall at disparity 4, before it a post at 10 in columns 20 to 25; and what the right camera sees of it."""
    disparity = torch.full((1, 1, 3, 40), 4.0)
    disparity[..., 20:26] = 10
    seen = torch.ones_like(disparity, dtype=torch.bool)
    seen[..., :4] = False  # beyond the border
    seen[..., 14:20] = False  # the post lands on columns 10 to 15, where the wall's 14 to 19 do
    return disparity, seen


def test_masks() -> None:
    disparity, seen = scene()
    out_of_view, occluded = reference.occlusion_masks(disparity)
    assert (out_of_view[..., :5] == torch.tensor([1, 1, 1, 0.5, 0])).all()  # columns 0 to 3 land on -4 to -1
    assert (occluded[..., 14:20] == torch.tensor([0, 0.25, 0.75, 1, 1, 1])).all()  # 0 to 5 right of the post's edge
    assert (torch.maximum(out_of_view, occluded)[seen] == 0).all()


def test_masks_are_continuous() -> None:
    """So that rounding, and training, do not make them jump."""
    disparity, _ = scene()
    step = torch.randn(disparity.shape, generator=torch.Generator().manual_seed(0)) * 1e-4
    for before, after in zip(
        reference.occlusion_masks(disparity), reference.occlusion_masks(disparity + step), strict=True
    ):
        assert (after - before).abs().max() < 1e-3


@pytest.mark.parametrize("module", [anynet_ext, reference])
def test_occlusions_take_the_background(module: Any) -> None:
    """Whatever the map says there, as long as it leaves them occluded."""
    truth, _ = scene()
    wrong = truth.clone()
    wrong[..., 18:20] = 5
    wrong[..., :2] = 9
    torch.testing.assert_close(module.fill_occlusions(4 * wrong, 4), 4 * truth)


@pytest.mark.parametrize("propagation", [anynet_ext.spatial_propagation, reference.spatial_propagation])
def test_the_reference_passes_gradients_to_the_background(propagation: Any) -> None:
    disparity, _ = scene()
    disparity.requires_grad_()
    reference.fill_occlusions(disparity, 1, propagation=propagation)[..., 17].sum().backward()
    assert disparity.grad is not None
    # 17 takes all of 16, which takes 3/4 of 15, which takes 1/4 of 14
    assert (disparity.grad[..., 14:18] == torch.tensor([0.1875, 0.5625, 0.25, 0])).all()
