"""What PyTorch's tools make of the operators' Python functions."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import anynet_ext

X = torch.rand(1, 2, 6, 7)
CALLS: dict[str, Callable[..., Any]] = {
    "batch_norm_relu": lambda x: anynet_ext.batch_norm_relu(x, torch.ones(2), torch.zeros(2)),
    "conv3x3": lambda x: anynet_ext.conv3x3(x, torch.ones(3, 2, 3, 3), stride=2),
    "cost_volume": lambda x: anynet_ext.cost_volume(x, x + 1, first=0, last=3),
    "resize": lambda x: anynet_ext.resize(x, (12, 14), scale=2.0),
    "soft_argmin": lambda x: anynet_ext.soft_argmin(x),
    "spatial_propagation": lambda x: anynet_ext.spatial_propagation(x, torch.full((1, 3, 2, 6, 7), 0.25), 0),
    "upsample_sum": lambda x: anynet_ext.upsample_sum([x[0, 0], x[0, 1]], [2, 2], 12, 14),
    "warp": lambda x: anynet_ext.warp(x, x[:, :1]),
}


@pytest.mark.parametrize("name", list(CALLS))
def test_fx_traces_a_function_as_one_call(name: str) -> None:
    graph = torch.fx.symbolic_trace(CALLS[name])
    assert [node.target for node in graph.graph.nodes].count(getattr(anynet_ext, name)) == 1
    for one, other in zip(_all(graph(X)), _all(CALLS[name](X)), strict=True):
        assert torch.equal(one, other)


def test_all_functions_can_be_overridden() -> None:
    class Own(Tensor):
        @classmethod
        def __torch_function__(cls, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
            return function

    own = X.as_subclass(Own)
    for name in anynet_ext.__all__:
        function = getattr(anynet_ext, name)
        if name not in ("build_info", "reference", "wait_passively"):
            parameters = inspect.signature(function).parameters.values()
            needed = [p for p in parameters if p.default is p.empty and p.kind is not p.KEYWORD_ONLY]
            assert function(*[own for _ in needed]) is function


def test_what_functorch_can_do() -> None:
    stack = torch.rand(3, 1, 4, 6, 7)
    assert torch.equal(torch.vmap(anynet_ext.soft_argmin)(stack)[1], anynet_ext.soft_argmin(stack[1]))
    for transform in (torch.func.grad, torch.func.jacrev):
        with pytest.raises(RuntimeError, match="must override the setup_context staticmethod"):
            transform(lambda cost: anynet_ext.soft_argmin(cost).sum())(stack[0])
    with pytest.raises(NotImplementedError, match="anynet::soft_argmin: forward-mode derivatives are not supported"):
        torch.func.jacfwd(anynet_ext.soft_argmin)(stack[0])
    assert torch.vmap(anynet_ext.warp)(stack[:0], stack[:0, :, :1]).shape == (0, *stack.shape[1:])
    by_autograd = torch.autograd.functional.jacobian(lambda cost: anynet_ext.soft_argmin(cost).sum(), stack[0])
    assert by_autograd.shape == stack[0].shape


@pytest.mark.parametrize("name", list(CALLS))
def test_forward_mode_is_refused(name: str) -> None:
    with pytest.raises(NotImplementedError, match=f"anynet::{name}: forward-mode derivatives are not supported"):
        torch.func.jvp(CALLS[name], (X,), (torch.ones_like(X),))


@pytest.mark.parametrize("name", list(CALLS))
def test_meta_tensors_have_the_results_shapes(name: str) -> None:
    with torch.device("meta"):
        found = _all(CALLS[name](X.to("meta")))
    assert [(t.device.type, t.shape) for t in found] == [("meta", t.shape) for t in _all(CALLS[name](X))]


OPS = torch.ops.anynet
WEIGHT, VECTOR = torch.ones(3, 2, 3, 3), torch.ones(2)
WRONG: dict[str, tuple[Callable[..., Any], list[Any], str]] = {
    "conv3x3, weight": (OPS.conv3x3, [X, WEIGHT[:, :1]], "conv3x3: expected weight of shape"),
    "conv3x3, dtype": (OPS.conv3x3, [X.double(), WEIGHT], "conv3x3: expected tensors of one dtype"),
    "conv3x3, int32": (OPS.conv3x3, [X.int(), WEIGHT.int()], "conv3x3: expected input of dtype"),
    "conv3x3, no pixel": (OPS.conv3x3, [X[..., :0], WEIGHT], "conv3x3: expected input of shape"),
    "conv3x3, bias": (OPS.conv3x3, [X, WEIGHT, VECTOR], "conv3x3: expected bias of shape"),
    "conv3x3, stride": (OPS.conv3x3, [X, WEIGHT, None, None, None, 5], "conv3x3: expected stride 1 or 2, got 5"),
    "conv3x3x3": (OPS.conv3x3x3, [X, WEIGHT], "conv3x3x3: expected input of shape"),
    "resize, int32": (OPS.resize, [X.int(), 8, 9], "resize: expected input of dtype"),
    "resize, no pixel": (OPS.resize, [X[..., :0], 8, 9], "resize: expected input of shape"),
    "resize, size": (OPS.resize, [X, 0, 9], "resize: expected size of at least 1 x 1, got 0 x 9"),
    "resize, add": (OPS.resize, [X, 8, 9, 1.0, X], "resize: expected add of shape"),
    "batch_norm_relu": (OPS.batch_norm_relu, [X, VECTOR, VECTOR[:1]], "batch_norm_relu: expected bias of shape"),
    "batch_norm_relu, int32": (
        OPS.batch_norm_relu, [X.int(), VECTOR, VECTOR], "batch_norm_relu: expected tensors of dtype"
    ),
    "batch_norm_relu, one": (
        OPS.batch_norm_relu, [X[..., 0, 0], VECTOR, VECTOR], "batch_norm_relu: expected more than one value"
    ),
}  # fmt: skip


@pytest.mark.parametrize(("op", "arguments", "message"), WRONG.values(), ids=WRONG.keys())
def test_wrong_meta_tensors_are_refused(op: Callable[..., Any], arguments: list[Any], message: str) -> None:
    """By the operator itself, where nothing else would."""
    meta = [a.to("meta") if isinstance(a, Tensor) else a for a in arguments]
    with pytest.raises((TypeError, ValueError), match=f"^{message}"):
        op(*meta)


@pytest.mark.parametrize("name", ["batch_norm_relu", "conv3x3", "cost_volume", "resize", "soft_argmin", "warp"])
def test_autocast_gives_float32(name: str) -> None:
    with torch.autocast("cpu"):
        assert all(out.dtype == torch.float32 for out in _all(CALLS[name](X.bfloat16())))


@pytest.mark.parametrize("name", ["batch_norm_relu", "conv3x3", "cost_volume", "resize", "soft_argmin", "warp"])
def test_autocast_leaves_float64(name: str) -> None:
    calls = CALLS | {
        "batch_norm_relu": lambda x: anynet_ext.batch_norm_relu(x, torch.ones(2).to(x), torch.zeros(2).to(x)),
        "conv3x3": lambda x: anynet_ext.conv3x3(x, torch.ones(3, 2, 3, 3).to(x), stride=2),
    }
    with torch.autocast("cpu"):
        assert all(out.dtype == torch.float64 for out in _all(calls[name](X.double())))


MIXTURES: dict[str, tuple[Callable[[], Any], str]] = {
    "warp, float64": (
        lambda: anynet_ext.warp(X.double(), X[:, :1]),
        "warp: expected all tensors of one dtype, got torch.float64 and, for disparity, torch.float32",
    ),
    "warp, int64": (
        lambda: anynet_ext.warp(X, X[:, :1].long()),
        "warp: expected all tensors of one dtype, got torch.float32 and, for disparity, torch.int64",
    ),
    "conv3x3": (
        lambda: anynet_ext.conv3x3(X.double(), torch.ones(1, 2, 3, 3).half()),
        "conv3x3: expected tensors of one dtype, float32 or float64, got torch.float16, torch.float64",
    ),
    "batch_norm_relu": (
        lambda: anynet_ext.batch_norm_relu(X.long(), torch.ones(2), torch.ones(2)),
        "batch_norm_relu: expected tensors of dtype float32 or float64, got torch.int64",
    ),
}


@pytest.mark.parametrize(("call", "message"), MIXTURES.values(), ids=MIXTURES.keys())
def test_autocast_refuses_what_it_does_not_mend(call: Callable[[], Any], message: str) -> None:
    with torch.autocast("cpu", torch.bfloat16), pytest.raises(TypeError) as caught:
        call()
    assert str(caught.value) == message


def test_operators_have_their_functions_defaults() -> None:
    ops = torch.ops.anynet
    cost, weight = torch.rand(1, 4, 6, 7, requires_grad=True), torch.rand(2, 4, 3, 3, requires_grad=True)
    pairs = [
        (ops.soft_argmin(cost), anynet_ext.soft_argmin(cost)),
        (ops.cost_volume(cost, cost), anynet_ext.cost_volume(cost, cost)),
        (ops.resize(cost, 8, 9), anynet_ext.resize(cost, (8, 9))),
        (ops.conv3x3(cost, weight), anynet_ext.conv3x3(cost, weight)),
        (ops.batch_norm_relu(cost, weight[0, :, 0, 0], weight[1, :, 0, 0])[0],
         anynet_ext.batch_norm_relu(cost, weight[0, :, 0, 0], weight[1, :, 0, 0])[0]),
    ]  # fmt: skip
    for one, other in pairs:
        assert torch.equal(one, other)
        inputs = [cost, weight]
        gradients = [torch.autograd.grad(out.sum(), inputs, allow_unused=True) for out in (one, other)]
        for a, b in zip(*gradients, strict=True):
            assert (a is None and b is None) or torch.equal(a, b)
    with torch.device("meta"):
        assert ops.soft_argmin(torch.rand(1, 4, 6, 7)).shape == (1, 1, 6, 7)
        assert ops.resize(torch.rand(1, 4, 6, 7), 8, 9).shape == (1, 4, 8, 9)
    assert torch.equal(torch.vmap(ops.soft_argmin)(cost[None])[0], pairs[0][1])


def _all(out: Any) -> tuple[Tensor, ...]:
    return out if isinstance(out, tuple) else (out,)
