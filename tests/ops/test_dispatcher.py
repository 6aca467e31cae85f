"""The operators as PyTorch citizens: opcheck, compile, export, vmap, autocast, inference mode, second derivatives."""

from __future__ import annotations

import pytest
import torch
from operator_cases import Case, disparity_map
from torch import Tensor
from torch._dynamo.testing import CompileCounterWithBackend

import anynet_ext

N, C, H, W = 2, 3, 4, 9


def _image() -> Tensor:
    return torch.randn(N, C, H, W)


def _disparity() -> Tensor:
    return disparity_map(N, H, W, 4).float()


def _gates() -> Tensor:
    return torch.rand(N, 3, C, H, W) * 0.5 - 0.25


CALLS = [
    Case("cost_volume", lambda: [_image(), _image(), None], (0, 3), "plain"),
    Case("cost_volume", lambda: [_image(), _image(), _disparity()], (-1, 1), "disparity"),
    Case("warp", lambda: [_image(), _disparity()], (), ""),
    Case("soft_argmin", lambda: [_image()], (1,), ""),
    Case("spatial_propagation", lambda: [_image(), _gates()], (2,), ""),
]
calls = pytest.mark.parametrize("call", CALLS, ids=repr)


def leaves(tensors: list[Tensor | None]) -> list[Tensor | None]:
    return [None if t is None else t.requires_grad_() for t in tensors]


def present(tensors: list[Tensor | None]) -> list[Tensor]:
    return [t for t in tensors if t is not None]


def backward_arguments(call: Case, tensors: list[Tensor | None]) -> tuple:
    out = call.run(anynet_ext, tensors)
    extra = [out] if call.op == "spatial_propagation" else []
    return (torch.ones_like(out), *tensors, *extra, *call.numbers)


@calls
def test_opcheck(call):
    tensors = call.make()
    op = getattr(torch.ops.anynet, call.op).default
    torch.library.opcheck(op, (*tensors, *call.numbers))
    torch.library.opcheck(op, (*leaves(tensors), *call.numbers))


@calls
def test_opcheck_backward(call):
    op = getattr(torch.ops.anynet, f"{call.op}_backward").default
    torch.library.opcheck(op, backward_arguments(call, call.make()))


@calls
def test_second_derivatives_are_refused(call):
    tensors = leaves(call.make())
    out = call.run(anynet_ext, tensors).square().sum()
    first = torch.autograd.grad(out, present(tensors)[0], create_graph=True)[0]
    with pytest.raises(RuntimeError, match=f"anynet::{call.op}_backward has no derivative: second derivatives"):
        first.sum().backward()


@calls
def test_compile(call):
    """One graph, without recompiling for other sizes, equal to eager in both passes."""
    counter = CompileCounterWithBackend("aot_eager")

    def function(*tensors: Tensor | None) -> Tensor:
        return call.run(anynet_ext, list(tensors)) * 2

    torch._dynamo.reset()
    compiled = torch.compile(function, fullgraph=True, dynamic=True, backend=counter)
    for crop in (0, 2):
        tensors = leaves([None if t is None else t[..., crop:].clone() for t in call.make()])
        results = []
        for f in (compiled, function):
            out = f(*tensors)
            results.append([out, *torch.autograd.grad(out.sum(), present(tensors))])
        torch.testing.assert_close(*results, rtol=0, atol=0)
    assert counter.frame_count == 1


@calls
@pytest.mark.slow
def test_compile_inductor(call):
    tensors = leaves(call.make())
    out = torch.compile(lambda *t: call.run(anynet_ext, list(t)) * 2, fullgraph=True, dynamic=True)(*tensors)
    torch.testing.assert_close(out, call.run(anynet_ext, tensors) * 2)
    out.sum().backward()


class _Module(torch.nn.Module):
    def __init__(self, call: Case) -> None:
        super().__init__()
        self.call = call

    def forward(self, tensors: list[Tensor | None]) -> Tensor:
        return self.call.run(anynet_ext, tensors)


@calls
def test_export(call):
    """An exported program keeps the operator and serves other sizes."""
    n, w = torch.export.Dim("n", min=1, max=64), torch.export.Dim("w", min=2, max=4096)
    tensors = call.make()
    dynamic = [None if t is None else {0: n, t.dim() - 1: w} for t in tensors]
    program = torch.export.export(_Module(call), (tensors,), dynamic_shapes=(dynamic,))
    assert f"torch.ops.anynet.{call.op}.default" in program.graph_module.code
    other = [None if t is None else t[:1, ..., :5].contiguous() for t in tensors]
    torch.testing.assert_close(program.module()(other), call.run(anynet_ext, other), rtol=0, atol=0)


@calls
def test_fake_kernels_of_unknown_sizes(call):
    """Shapes that are known only when the graph runs (unbacked) pass through, in both directions."""
    from torch._subclasses.fake_tensor import FakeTensorMode
    from torch.fx.experimental.symbolic_shapes import ShapeEnv

    env = ShapeEnv()
    n, h, w = (env.create_unbacked_symint() for _ in range(3))
    with FakeTensorMode(shape_env=env):
        tensors = [
            None if t is None else torch.empty(n, *t.shape[1:-2], h, w, dtype=torch.float16) for t in call.make()
        ]
        arguments = backward_arguments(call, tensors)
        out = arguments[0]
        channels = {"cost_volume": call.numbers[-1:] and call.numbers[-1] - call.numbers[0] + 1, "soft_argmin": 1}
        assert [str(s) for s in out.shape] == [str(s) for s in (n, channels.get(call.op, C), h, w)]
        assert out.dtype == torch.float16
        grads = getattr(torch.ops.anynet, f"{call.op}_backward")(*arguments)
        grads = [grads] if isinstance(grads, Tensor) else grads
        for grad, t in zip(grads, present(tensors), strict=False):
            assert [str(s) for s in grad.shape] == [str(s) for s in t.shape]


@calls
def test_vmap(call):
    """Mapped over any dimension, and shared tensors, equals a loop; gradients too."""
    stacks = [None if t is None else torch.stack([t, t + 0.01, t - 0.02], dim=i) for i, t in enumerate(call.make())]
    stacks = leaves(stacks)

    def run(*tensors: Tensor | None) -> Tensor:
        return call.run(anynet_ext, list(tensors))

    dims = tuple(None if t is None else i for i, t in enumerate(stacks))
    mapped = torch.vmap(run, in_dims=dims)(*stacks)
    looped = torch.stack(
        [run(*[None if t is None else t.select(d, i) for t, d in zip(stacks, dims, strict=True)]) for i in range(3)]
    )
    torch.testing.assert_close(mapped, looped, rtol=0, atol=0)
    grad = torch.randn_like(mapped)
    torch.testing.assert_close(
        torch.autograd.grad(mapped, present(stacks), grad), torch.autograd.grad(looped, present(stacks), grad)
    )
    if len(present(stacks)) > 1:
        shared = [t if t is None or i == 0 else t.select(i, 0) for i, t in enumerate(stacks)]
        mapped = torch.vmap(run, in_dims=(0, *[None] * (len(shared) - 1)))(*shared)
        torch.testing.assert_close(mapped, torch.stack([run(t, *shared[1:]) for t in shared[0]]), rtol=0, atol=0)


@calls
def test_vmap_backward(call):
    arguments = backward_arguments(call, call.make())
    op = getattr(torch.ops.anynet, f"{call.op}_backward")
    grads = torch.stack([arguments[0], -2 * arguments[0]])
    mapped = torch.vmap(lambda grad: op(grad, *arguments[1:]))(grads)
    looped = [op(grad, *arguments[1:]) for grad in grads]
    if isinstance(mapped, Tensor):
        torch.testing.assert_close(mapped, torch.stack(looped), rtol=0, atol=0)
    else:
        for i, one in enumerate(mapped):
            torch.testing.assert_close(one, torch.stack([each[i] for each in looped]), rtol=0, atol=0)


@calls
def test_inference_mode(call):
    tensors = call.make()
    with torch.inference_mode():
        out = call.run(anynet_ext, [None if t is None else t.clone() for t in tensors])
    assert out.is_inference()
    torch.testing.assert_close(out, call.run(anynet_ext, tensors), rtol=0, atol=0)


@calls
@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16], ids=str)
def test_autocast(call, dtype):
    """Under autocast the operators compute in float32, whatever mixture of dtypes arrives."""
    tensors = [None if t is None else t.to(dtype if i == 0 else torch.float32) for i, t in enumerate(call.make())]
    leaves(tensors)
    with torch.autocast("cpu", dtype):
        out = call.run(anynet_ext, tensors)
    assert out.dtype == torch.float32
    torch.testing.assert_close(out, call.run(anynet_ext, [None if t is None else t.float() for t in tensors]))
    grads = torch.autograd.grad(out.sum(), present(tensors))
    assert [g.dtype for g in grads] == [t.dtype for t in present(tensors)]


@calls
def test_only_wanted_gradients(call):
    for i, t in enumerate(present(call.make())):
        tensors = call.make()
        leaf = tensors[i] = t.requires_grad_()
        (grad,) = torch.autograd.grad(call.run(anynet_ext, tensors).sum(), leaf)
        assert grad.shape == leaf.shape
