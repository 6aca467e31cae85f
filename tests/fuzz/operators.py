"""Random calls of the raw operators: mostly what they expect, with one to three arguments spoilt."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from random import Random
from typing import Any

DOCUMENTED = (RuntimeError, TypeError, ValueError, IndexError, MemoryError)

# Shapes of each operator's tensors, in order; letters are sizes drawn once per call, h and w are half of H and W.
SHAPES = {
    "batch_norm_relu": "NCHW C C",
    "batch_norm_relu_backward": "NCHW NCHW C C C C",
    "candidate_costs": "2CHW 11HW",
    "conv3x3": "NCHW KC33 K C C",
    "conv3x3_backward_input": "NKHW KC33 NCHW",
    "conv3x3_backward_weight": "NKHW NCHW C C",
    "conv3x3x3": "NCDHW KC333 K C C",
    "conv3x3x3_backward_input": "NKDHW KC333 NCDHW",
    "conv3x3x3_backward_weight": "NKDHW NCDHW C C",
    "conv_chain": "NCHW CC33 C",
    "convex_upsampling": "N1HW N(32)HW",
    "cost_volume": "NCHW NCHW N1HW",
    "cost_volume_affine_relu": "NCHW NCHW N1HW 1 1",
    "cost_volume_backward": "NDHW NCHW NCHW N1HW",
    "expected_disparity": "1DHW 11HW 12HW",
    "fill_occlusions": "N1HW",
    "max_pool": "NCHW C C",
    "normalized_propagation": "NCHW N3CHW",
    "read_image": "HW3 3 3",
    "refinement_guide": "HW3 HW3 11HW 3 3",
    "resize": "NCHW NCHW",
    "resize_backward": "NCHW",
    "soft_argmin": "NDHW",
    "soft_argmin_backward": "N1HW NDHW",
    "spatial_propagation": "NCHW N3CHW",
    "spatial_propagation_backward": "NCHW NCHW N3CHW NCHW",
    "stem": "HW3 HW3 3 C333 C CC33 C C",
    "upsample_add": "NCDHW NCDhw C C",
    "upsample_concat": "NCHW NKhw (C+K) (C+K)",
    "upsample_sum": "HW HW",
    "warp": "NCHW N1HW",
    "warp_backward": "NCHW NCHW N1HW",
}
_IMAGES = ("read_image", "refinement_guide", "stem")  # of bytes; the other tensors of one floating type
_EXTREMES = [-(2**63), -(2**31), -1, 0, 2**31 - 1, 2**31, 2**40, 2**62, 2**63 - 1]
_SMALL = [-3, -1, 0, 1, 2, 3, 4, 7]


def call(key: str) -> bool:
    """Makes the call of a key; whether it was accepted."""
    random = Random(key)
    return accepted(*random.choice(operators()), random, spoilt=(0, 0, 1, 1, 1, 2, 3))


def accepted(name: str, schema: Any, operator: Callable[..., Any], random: Random, spoilt: Sequence[int]) -> bool:
    """Whether an operator accepts arguments of which one of so many numbers are spoilt."""
    import torch

    torch.default_generator.manual_seed(random.randrange(2**32))  # torch.manual_seed is slow: it tells every device
    torch.set_num_threads(random.choice((1, 1, 2, 3)))
    sizes = {letter: random.choice((1, 1, 2, 3, 4, 5, 8, 17)) for letter in "NCDHWK"}
    if random.random() < 0.1:
        sizes[random.choice("NCDHWK")] = random.choice((0, 0, 33, 70))
    sizes |= {"h": max(1, sizes["H"] // 2), "w": max(1, sizes["W"] // 2), "maps": random.choice((1, 1, 2, 5))}
    sizes["first"] = random.choice((-2, 0, 1))
    dtype = random.choice((torch.float32, torch.float32, torch.float64, torch.bfloat16, torch.float16))
    shapes = iter(SHAPES[name].split())
    arguments = [_argument(name, one, shapes, sizes, dtype, random) for one in schema.arguments]
    for _ in range(random.choice(spoilt)):
        place = random.randrange(len(arguments))
        arguments[place] = _spoilt(arguments[place], random)
    try:
        operator(*arguments)
    except DOCUMENTED:
        return False
    return True


@cache
def operators() -> list[tuple[str, Any, Callable[..., Any]]]:
    import torch
    import torch._dynamo  # some calls do, which takes seconds

    import anynet_ext  # noqa: F401 (registers them)

    schemas = [schema for schema in torch._C._jit_get_all_schemas() if schema.name.startswith("anynet::")]
    named = [(schema.name.removeprefix("anynet::"), schema) for schema in sorted(schemas, key=lambda one: one.name)]
    return [(name, schema, _overload(getattr(torch.ops.anynet, name), schema)) for name, schema in named]


def _overload(packet: Any, schema: Any) -> Callable[..., Any]:
    """The operator of this schema, all of whose arguments go by position."""
    overload = getattr(packet, schema.overload_name or "default")
    by_position = sum(not argument.kwarg_only for argument in schema.arguments)
    by_name = [argument.name for argument in schema.arguments[by_position:]]

    def call(*arguments: Any) -> Any:
        return overload(*arguments[:by_position], **dict(zip(by_name, arguments[by_position:], strict=True)))

    return call


def _argument(name: str, argument: Any, shapes: Any, sizes: dict[str, int], dtype: Any, random: Random) -> Any:
    kind = str(argument.type)
    if "Tensor" in kind:
        shape = _shape(next(shapes, "NCHW"), sizes)
        if kind.startswith("List"):
            return [_tensor(shape, dtype, random) for _ in range(sizes["maps"])]
        if kind.startswith("Optional") and random.random() < 0.4:
            return None
        if name in _IMAGES:
            import torch

            return _tensor(shape, torch.uint8 if argument.name in ("left", "right", "image") else torch.float32, random)
        return _tensor(shape, dtype, random)
    if kind.startswith("List"):
        if argument.name == "ratios":
            return [*(random.choice((1, 1, 2, 4)) for _ in range(sizes["maps"] - 1)), 1]
        if argument.name == "gains":
            return [random.choice((1.0, 0.5)) for _ in range(random.choice((0, sizes["maps"])))]
        return [sizes[letter] for letter in ("NCDHW" if "x3x3" in name else "NCHW")]
    if argument.name == "side":
        return random.choice((0.0, 0.25, 0.5))
    if kind == "float":
        return random.choice((1.0, 1.0, 0.5, 2.0, 1e-5))
    if kind == "bool":
        return random.random() < 0.5
    known = {"height": sizes["H"], "width": sizes["W"], "direction": random.randrange(4), "multiple": 4, "groups": 1}
    known |= {"first": sizes["first"], "last": random.choice((1, 2, 11)), "stride": 1, "block": 1}
    if name == "cost_volume_backward":
        known["last"] = sizes["first"] + sizes["D"] - 1
    return known.get(argument.name, random.choice((1, 2)))


def _shape(text: str, sizes: dict[str, int]) -> list[int]:
    shape = []
    while text:
        if text[0] == "(":
            inner, text = text[1:].split(")", 1)
            shape.append(sum(sizes[part] if part in sizes else int(part) for part in inner.split("+")))
        else:
            shape.append(sizes[text[0]] if text[0] in sizes else int(text[0]))
            text = text[1:]
    return shape


def _tensor(shape: list[int], dtype: Any, random: Random) -> Any:
    import torch

    if not dtype.is_floating_point:
        return torch.randint(0, 100, shape, dtype=dtype)
    tensor = (random.choice((1, 1, 5, 1e4)) * torch.randn(shape)).to(dtype)
    if random.random() < 0.2 and tensor.numel():
        value = random.choice((math.nan, math.inf, -math.inf, 3e38, -1e9, 2**31))
        tensor.view(-1)[torch.randint(tensor.numel(), (3,))] = torch.tensor(value).to(dtype)
    if random.random() < 0.2 and tensor.dim() > 1:
        tensor = tensor.transpose(-1, -2).contiguous().transpose(-1, -2)
    return tensor


def _spoilt(value: Any, random: Random) -> Any:
    import torch

    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return random.choice(random.choice((_EXTREMES, _SMALL)))
    if isinstance(value, float):
        return random.choice((0.0, -1.0, math.nan, math.inf, -math.inf, 1e300, 1e-300))
    if isinstance(value, list):
        return [_spoilt(one, random) for one in value][: random.choice((0, 1, 2, 9))]
    if value is None:
        return torch.randn(random.choice(([], [1], [2, 3, 4, 5])))
    change = random.randrange(6)
    if change == 0:
        types = (torch.float32, torch.float64, torch.float16, torch.bfloat16, torch.int64, torch.uint8, torch.bool)
        return value.to(random.choice((*types, torch.complex64)))
    if change == 1:
        return torch.zeros([random.choice((0, 1, 2, 3)) for _ in range(random.randrange(7))])
    if change == 2 and value.dim():
        return value.narrow(random.randrange(value.dim()), 0, 0)
    if change == 3 and value.dim():
        return torch.cat([value, value], random.randrange(value.dim()))
    if change == 4:
        return value[None] if random.random() < 0.5 or not value.dim() else value[0] if value.shape[0] else value
    return value.to("meta") if random.random() < 0.3 else torch.full_like(value, 7) * 2**20
