"""Wrong arguments: a TypeError or ValueError from the functions, a RuntimeError from `torch.ops`, with what came."""

from __future__ import annotations

import pytest
import torch

import anynet_ext

IMAGE = torch.zeros(2, 3, 4, 5)
DISPARITY = torch.zeros(2, 1, 4, 5)
GATES = torch.zeros(2, 3, 3, 4, 5)

FUNCTIONS = [
    ("cost_volume", (None, IMAGE), TypeError, "cost_volume: expected left to be a Tensor, got NoneType"),
    ("cost_volume", (IMAGE, 3), TypeError, "cost_volume: expected right to be a Tensor, got int"),
    ("cost_volume", (IMAGE, IMAGE, 3), TypeError, "cost_volume: expected disparity to be a Tensor, got int"),
    (
        "cost_volume",
        (IMAGE.int(), IMAGE),
        TypeError,
        "cost_volume: expected left of dtype float32, float64, float16 or bfloat16, got torch.int32",
    ),
    ("cost_volume", (IMAGE[0], IMAGE), ValueError, "cost_volume: expected left of shape [N, C, H, W], got [3, 4, 5]"),
    (
        "cost_volume",
        (IMAGE, IMAGE[..., :4]),
        ValueError,
        "cost_volume: expected right of shape [2, 3, 4, 5], got [2, 3, 4, 4]",
    ),
    (
        "cost_volume",
        (IMAGE, IMAGE, IMAGE),
        ValueError,
        "cost_volume: expected disparity of shape [2, 1, 4, 5], got [2, 3, 4, 5]",
    ),
    (
        "cost_volume",
        (IMAGE, IMAGE.double()),
        TypeError,
        "cost_volume: expected all tensors of one dtype, got torch.float32 and, for right, torch.float64",
    ),
    (
        "cost_volume",
        (IMAGE, IMAGE, DISPARITY.half()),
        TypeError,
        "cost_volume: expected all tensors of one dtype, got torch.float32 and, for disparity, torch.float16",
    ),
    (
        "cost_volume",
        (IMAGE, IMAGE.to("meta")),
        ValueError,
        "cost_volume: expected all tensors on one device, got cpu and, for right, meta",
    ),
    (
        "cost_volume",
        (IMAGE, IMAGE, None, 3, 2),
        ValueError,
        "cost_volume: expected first <= last, got first 3 and last 2",
    ),
    ("cost_volume", (IMAGE, IMAGE, None, 0.5, 2), TypeError, "cost_volume: expected first to be an int, got float"),
    ("cost_volume", (IMAGE, IMAGE, None, 0, True), TypeError, "cost_volume: expected last to be an int, got bool"),
    ("warp", ([], DISPARITY), TypeError, "warp: expected image to be a Tensor, got list"),
    (
        "warp",
        (IMAGE.bool(), DISPARITY),
        TypeError,
        "warp: expected image of dtype float32, float64, float16 or bfloat16, got torch.bool",
    ),
    ("warp", (IMAGE[0, 0], DISPARITY), ValueError, "warp: expected image of shape [N, C, H, W], got [4, 5]"),
    ("warp", (IMAGE, None), TypeError, "warp: expected disparity to be a Tensor, got NoneType"),
    ("warp", (IMAGE, DISPARITY[:1]), ValueError, "warp: expected disparity of shape [2, 1, 4, 5], got [1, 1, 4, 5]"),
    ("warp", (IMAGE, DISPARITY[:, 0]), ValueError, "warp: expected disparity of shape [2, 1, 4, 5], got [2, 4, 5]"),
    (
        "warp",
        (IMAGE, DISPARITY.bfloat16()),
        TypeError,
        "warp: expected all tensors of one dtype, got torch.float32 and, for disparity, torch.bfloat16",
    ),
    (
        "warp",
        (IMAGE, DISPARITY.to("meta")),
        ValueError,
        "warp: expected all tensors on one device, got cpu and, for disparity, meta",
    ),
    ("soft_argmin", ("cost",), TypeError, "soft_argmin: expected cost to be a Tensor, got str"),
    (
        "soft_argmin",
        (IMAGE.long(),),
        TypeError,
        "soft_argmin: expected cost of dtype float32, float64, float16 or bfloat16, got torch.int64",
    ),
    ("soft_argmin", (GATES,), ValueError, "soft_argmin: expected cost of shape [N, D, H, W], got [2, 3, 3, 4, 5]"),
    (
        "soft_argmin",
        (IMAGE[:, :0],),
        ValueError,
        "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got [2, 0, 4, 5]",
    ),
    ("soft_argmin", (IMAGE, 1.0), TypeError, "soft_argmin: expected first to be an int, got float"),
    ("spatial_propagation", (0, GATES, 0), TypeError, "spatial_propagation: expected input to be a Tensor, got int"),
    (
        "spatial_propagation",
        (IMAGE.int(), GATES, 0),
        TypeError,
        "spatial_propagation: expected input of dtype float32, float64, float16 or bfloat16, got torch.int32",
    ),
    (
        "spatial_propagation",
        (GATES, GATES, 0),
        ValueError,
        "spatial_propagation: expected input of shape [N, C, H, W], got [2, 3, 3, 4, 5]",
    ),
    (
        "spatial_propagation",
        (IMAGE, IMAGE, 0),
        ValueError,
        "spatial_propagation: expected gates of shape [2, 3, 3, 4, 5], got [2, 3, 4, 5]",
    ),
    (
        "spatial_propagation",
        (IMAGE, GATES[:, :2], 0),
        ValueError,
        "spatial_propagation: expected gates of shape [2, 3, 3, 4, 5], got [2, 2, 3, 4, 5]",
    ),
    (
        "spatial_propagation",
        (IMAGE, GATES.double(), 0),
        TypeError,
        "spatial_propagation: expected all tensors of one dtype, got torch.float32 and, for gates, torch.float64",
    ),
    (
        "spatial_propagation",
        (IMAGE, GATES.to("meta"), 0),
        ValueError,
        "spatial_propagation: expected all tensors on one device, got cpu and, for gates, meta",
    ),
    (
        "spatial_propagation",
        (IMAGE, GATES, 4),
        ValueError,
        "spatial_propagation: expected direction 0, 1, 2 or 3, got 4",
    ),
    (
        "spatial_propagation",
        (IMAGE, GATES, -1),
        ValueError,
        "spatial_propagation: expected direction 0, 1, 2 or 3, got -1",
    ),
    (
        "spatial_propagation",
        (IMAGE, GATES, "left"),
        TypeError,
        "spatial_propagation: expected direction to be an int, got str",
    ),
]


@pytest.mark.parametrize(("name", "args", "error", "message"), FUNCTIONS, ids=[message for *_, message in FUNCTIONS])
def test_functions(name, args, error, message):
    with pytest.raises(error) as caught:
        getattr(anynet_ext, name)(*args)
    assert str(caught.value) == message


OPERATORS = [
    ("cost_volume", (IMAGE[0], IMAGE, None, 0, 1), "cost_volume: expected left of shape [N, C, H, W], got [3, 4, 5]"),
    (
        "cost_volume",
        (IMAGE, IMAGE[:1], None, 0, 1),
        "cost_volume: expected right of shape [2, 3, 4, 5], got [1, 3, 4, 5]",
    ),
    (
        "cost_volume",
        (IMAGE, IMAGE.double(), None, 0, 1),
        "cost_volume: expected all tensors of one dtype, got Float and, for right, Double",
    ),
    (
        "cost_volume",
        (IMAGE, IMAGE, IMAGE, 0, 1),
        "cost_volume: expected disparity of shape [2, 1, 4, 5], got [2, 3, 4, 5]",
    ),
    ("cost_volume", (IMAGE, IMAGE, None, 1, 0), "cost_volume: expected first <= last, got first 1 and last 0"),
    (
        "cost_volume",
        (IMAGE.int(), IMAGE.int(), None, 0, 1),
        "cost_volume: expected a tensor of dtype float32, float64, float16 or bfloat16, got Int",
    ),
    (
        "cost_volume_backward",
        (IMAGE, IMAGE, IMAGE, None, 0, 1),
        "cost_volume_backward: expected grad of shape [2, 2, 4, 5], got [2, 3, 4, 5]",
    ),
    (
        "cost_volume_backward",
        (IMAGE[:, :2].half(), IMAGE, IMAGE, None, 0, 1),
        "cost_volume_backward: expected all tensors of one dtype, got Float and, for grad, Half",
    ),
    ("warp", (IMAGE[0], DISPARITY), "warp: expected image of shape [N, C, H, W], got [3, 4, 5]"),
    ("warp", (IMAGE, IMAGE), "warp: expected disparity of shape [2, 1, 4, 5], got [2, 3, 4, 5]"),
    (
        "warp_backward",
        (DISPARITY, IMAGE, DISPARITY),
        "warp_backward: expected grad of shape [2, 3, 4, 5], got [2, 1, 4, 5]",
    ),
    ("soft_argmin", (IMAGE[0], 0), "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got [3, 4, 5]"),
    (
        "soft_argmin",
        (IMAGE[:, :0], 0),
        "soft_argmin: expected cost of shape [N, D, H, W] with D >= 1, got [2, 0, 4, 5]",
    ),
    (
        "soft_argmin_backward",
        (IMAGE, IMAGE, 0),
        "soft_argmin_backward: expected grad of shape [2, 1, 4, 5], got [2, 3, 4, 5]",
    ),
    (
        "spatial_propagation",
        (GATES, GATES, 0),
        "spatial_propagation: expected input of shape [N, C, H, W], got [2, 3, 3, 4, 5]",
    ),
    (
        "spatial_propagation",
        (IMAGE, IMAGE, 0),
        "spatial_propagation: expected gates of shape [2, 3, 3, 4, 5], got [2, 3, 4, 5]",
    ),
    ("spatial_propagation", (IMAGE, GATES, 7), "spatial_propagation: expected direction 0, 1, 2 or 3, got 7"),
    (
        "spatial_propagation_backward",
        (DISPARITY, IMAGE, GATES, IMAGE, 0),
        "spatial_propagation_backward: expected grad of shape [2, 3, 4, 5], got [2, 1, 4, 5]",
    ),
    (
        "spatial_propagation_backward",
        (IMAGE, IMAGE, GATES, DISPARITY, 0),
        "spatial_propagation_backward: expected out of shape [2, 3, 4, 5], got [2, 1, 4, 5]",
    ),
]


@pytest.mark.parametrize(("name", "args", "message"), OPERATORS, ids=[message for *_, message in OPERATORS])
def test_operators(ops, name, args, message):
    with pytest.raises(RuntimeError) as caught:
        getattr(getattr(torch.ops, ops.namespace), name)(
            *[a.to(ops.device) if isinstance(a, torch.Tensor) else a for a in args]
        )
    assert str(caught.value).splitlines()[0] == message
