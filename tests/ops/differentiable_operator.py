"""What the differentiable operators must do: one table of calls and two of wrong calls drive all of it."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from operator_cases import DTYPES, ISAS, LAYOUTS, TOLERANCES, Case, from_array, to_array
from torch import Tensor

import anynet_ext
from anynet_ext import _kernels, reference


def expected(case: Case, tensors: list[Tensor | None], grad: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Result and gradients of the reference, computed in float64 from the same values."""
    wide = [None if t is None else t.detach().cpu().double().requires_grad_() for t in tensors]
    out = case.run(reference, wide)
    inputs = [t for t in wide if t is not None]
    grads = torch.autograd.grad(out, inputs, grad.cpu().double(), materialize_grads=True)
    return out.detach(), list(grads)


@cache  # of a case and a type for all its layouts and instruction sets
def expected_of(case: Case, dtype: torch.dtype) -> tuple[Tensor, Tensor, list[Tensor]]:
    """A gradient for the result of the case's own tensors, and the reference's result and gradients."""
    tensors = case.tensors(dtype)
    grad = torch.randn(out_shape(case, tensors), dtype=torch.float64).to(dtype)
    return grad, *expected(case, tensors, grad)


def actual(ops, case: Case, tensors: list[Tensor | None], grad: Tensor) -> tuple[Tensor, list[Tensor]]:
    leaves = [None if t is None else t.detach().requires_grad_() for t in tensors]
    out = case.run(ops, leaves)
    return out.detach(), list(torch.autograd.grad(out, [t for t in leaves if t is not None], grad))


def gradient_tolerance(op: str, i: int, dtype: torch.dtype) -> dict[str, float]:
    """Of the gradient of the i-th tensor."""
    tolerance = dict(TOLERANCES[dtype])
    if op == "spatial_propagation" and i == 1:  # reads the forward pass's rounded result
        tolerance["atol"] = tolerance["rtol"] * 16
    elif op == "soft_argmin" and dtype == torch.float32:  # differences from a mean of up to 192, itself rounded
        tolerance["atol"] = 1e-4
    return tolerance


def check(
    ops,
    case: Case,
    dtype: torch.dtype,
    tensors: list[Tensor | None],
    grad: Tensor,
    expected_out: Tensor,
    expected_grads: list[Tensor],
) -> None:
    out, grads = actual(ops, case, tensors, grad)
    assert out.is_contiguous()
    # The reference stays in float64: rounded as well, it could land on the next number but one.
    assert out.dtype == dtype
    torch.testing.assert_close(out.cpu().double(), expected_out, **TOLERANCES[dtype])
    for i, (one, other) in enumerate(zip(grads, expected_grads, strict=True)):
        assert one.dtype == dtype
        torch.testing.assert_close(one.cpu().double(), other, **gradient_tolerance(case.op, i, dtype))


def out_shape(case: Case, tensors: list[Tensor | None]) -> torch.Size:
    return case.run(reference, [None if t is None else t.detach() for t in tensors]).shape


def leaves(tensors: list[Tensor | None]) -> list[Tensor | None]:
    return [None if t is None else t.requires_grad_() for t in tensors]


def present(tensors: list[Tensor | None]) -> list[Tensor]:
    return [t for t in tensors if t is not None]


def backward_arguments(call: Case, tensors: list[Tensor | None]) -> tuple:
    out = call.run(anynet_ext, tensors)
    extra = [out] if call.op == "spatial_propagation" else []
    return (torch.ones_like(out), *tensors, *extra, *call.numbers)


class _Module(torch.nn.Module):
    def __init__(self, call: Case) -> None:
        super().__init__()
        self.call = call

    def forward(self, tensors: list[Tensor | None]) -> Tensor:
        return self.call.run(anynet_ext, tensors)


def reversed_columns(a: np.ndarray) -> np.ndarray:
    """The same values through a negative stride."""
    return np.ascontiguousarray(a[..., ::-1])[..., ::-1]


class DifferentiableOperator:
    """Base class of a test class; its lists are the values of its tests' parameters (see conftest.py).

    Attributes:
        op: the operator's name.
        cases: calls of every size.
        calls: one call of each kind, of shape N, C, H, W = 2, 3, 4, 9.
        large_calls: the same, large enough that several threads take part.
        function_errors: wrong arguments of `anynet_ext.<op>`, the exception and its message.
        operator_errors: wrong arguments of `torch.ops.anynet.<name>` and the message.
    """

    op: ClassVar[str]
    cases: ClassVar[list[Case]]
    calls: ClassVar[list[Case]]
    large_calls: ClassVar[list[Case]]
    function_errors: ClassVar[list[tuple[tuple[Any, ...], type[Exception], str]]]
    operator_errors: ClassVar[list[tuple[str, tuple[Any, ...], str]]]
    layout_cases: ClassVar[list[Case]]
    gradcheck_cases: ClassVar[list[Case]]

    def __init_subclass__(cls) -> None:
        cls.layout_cases = [case for case in cls.cases if "2x3x4x7" in case.name or "37" in case.name]
        cls.gradcheck_cases = [case for case in cls.cases if "x130" not in case.name and "192" not in case.name]

    @pytest.mark.parametrize("dtype", DTYPES, ids=str)
    def test_sizes(self, ops, case, dtype):
        tensors = [None if t is None else t.to(ops.device) for t in case.tensors(dtype)]
        grad, *results = expected_of(case, dtype)
        check(ops, case, dtype, tensors, grad.to(ops.device), *results)

    @pytest.mark.parametrize("dtype", DTYPES, ids=str)
    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_layouts(self, ops, layout_case, layout, dtype):
        tensors = [None if t is None else LAYOUTS[layout](t.to(ops.device)) for t in layout_case.tensors(dtype)]
        grad, *results = expected_of(layout_case, dtype)
        check(ops, layout_case, dtype, tensors, LAYOUTS[layout](grad.to(ops.device)), *results)

    @pytest.mark.parametrize("dtype", DTYPES, ids=str)
    def test_expanded(self, ops, layout_case, dtype):
        """Stride 0: gradients as `sum().backward()` makes them, and inputs shared by the batch."""
        tensors = [None if t is None else t.to(ops.device) for t in layout_case.tensors(dtype)]
        tensors = [None if t is None else t[:1].expand(2, *t.shape[1:]) for t in tensors]
        grad = torch.ones((), dtype=dtype, device=ops.device).expand(out_shape(layout_case, tensors))
        check(ops, layout_case, dtype, tensors, grad, *expected(layout_case, tensors, grad))

    def test_gradcheck(self, ops, gradcheck_case):
        tensors = [
            None if t is None else t.to(ops.device).requires_grad_() for t in gradcheck_case.tensors(torch.float64)
        ]
        if any(t is not None and t.numel() == 0 for t in tensors):
            pytest.skip("nothing to differentiate")
        assert torch.autograd.gradcheck(
            lambda *args: gradcheck_case.run(ops, list(args)), tensors, eps=1e-4, atol=1e-6, fast_mode=True
        )

    @pytest.mark.parametrize("dtype", DTYPES, ids=str)
    @pytest.mark.parametrize("isa", ISAS, ids=lambda isa: isa.name)
    def test_kernels(self, case, isa, dtype):
        grad, expected_out, expected_grads = expected_of(case, dtype)
        arrays = [None if t is None else reversed_columns(to_array(t)) for t in case.tensors(dtype)]
        out = getattr(_kernels, case.op)(isa, *arrays, *case.numbers, 2)
        torch.testing.assert_close(from_array(out).double(), expected_out, **TOLERANCES[dtype])
        extra = [out] if case.op == "spatial_propagation" else []
        backward = getattr(_kernels, f"{case.op}_backward")
        grads = backward(isa, reversed_columns(to_array(grad)), *arrays, *extra, *case.numbers, 2)
        grads = [g for g in (grads if isinstance(grads, tuple) else (grads,)) if g is not None]
        for i, (one, other) in enumerate(zip(grads, expected_grads, strict=True)):
            torch.testing.assert_close(from_array(one).double(), other, **gradient_tolerance(case.op, i, dtype))

    @pytest.mark.parametrize("dtype", DTYPES, ids=str)
    def test_bit_equality(self, ops, large_call, dtype, threads):
        tensors = [None if t is None else t.to(ops.device, dtype).requires_grad_() for t in large_call.make()]
        leaves = [t for t in tensors if t is not None]
        grad = None
        expected = None
        for count in (1, 1, 2, 3, 7, 2):
            threads(count)
            out = large_call.run(ops, tensors)
            grad = torch.randn_like(out) if grad is None else grad
            results = [out.detach(), *torch.autograd.grad(out, leaves, grad)]
            expected = results if expected is None else expected
            for one, other in zip(results, expected, strict=True):
                assert torch.equal(one, other), f"{count} threads"

    def test_opcheck(self, call):
        tensors = call.make()
        op = getattr(torch.ops.anynet, call.op).default
        torch.library.opcheck(op, (*tensors, *call.numbers))
        torch.library.opcheck(op, (*leaves(tensors), *call.numbers))

    def test_opcheck_backward(self, call):
        op = getattr(torch.ops.anynet, f"{call.op}_backward").default
        torch.library.opcheck(op, backward_arguments(call, call.make()))

    def test_second_derivatives_are_refused(self, call):
        tensors = leaves(call.make())
        out = call.run(anynet_ext, tensors).square().sum()
        first = torch.autograd.grad(out, present(tensors)[0], create_graph=True)[0]
        with pytest.raises(RuntimeError, match=f"anynet::{call.op}_backward has no derivative: second derivatives"):
            first.sum().backward()

    def test_forward_mode_is_refused(self, call):
        backward = backward_arguments(call, call.make())
        for name, (first, *others) in ((call.op, [*call.make(), *call.numbers]), (f"{call.op}_backward", backward)):
            with torch.autograd.forward_ad.dual_level():
                dual = torch.autograd.forward_ad.make_dual(first, torch.ones_like(first))
                with pytest.raises(NotImplementedError, match=f"anynet::{name}: forward-mode derivatives are not"):
                    getattr(torch.ops.anynet, name)(dual, *others)

    def test_compile(self, call):
        """One graph, without recompiling for other sizes, equal to eager in both passes."""
        from torch._dynamo.testing import CompileCounterWithBackend

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

    @pytest.mark.slow
    def test_compile_inductor(self, call):
        tensors = leaves(call.make())
        out = torch.compile(lambda *t: call.run(anynet_ext, list(t)) * 2, fullgraph=True, dynamic=True)(*tensors)
        torch.testing.assert_close(out, call.run(anynet_ext, tensors) * 2)
        out.sum().backward()

    def test_export(self, call):
        """An exported program keeps the operator and serves other sizes."""
        n, w = torch.export.Dim("n", min=1, max=64), torch.export.Dim("w", min=2, max=4096)
        tensors = call.make()
        dynamic = [None if t is None else {0: n, t.dim() - 1: w} for t in tensors]
        program = torch.export.export(_Module(call), (tensors,), dynamic_shapes=(dynamic,))
        assert f"torch.ops.anynet.{call.op}.default" in program.graph_module.code
        other = [None if t is None else t[:1, ..., :5].contiguous() for t in tensors]
        torch.testing.assert_close(program.module()(other), call.run(anynet_ext, other), rtol=0, atol=0)

    def test_fake_kernels_of_unknown_sizes(self, call):
        """Shapes that are known only when the graph runs (unbacked) pass through, in both directions."""
        from torch._subclasses.fake_tensor import FakeTensorMode
        from torch.fx.experimental.symbolic_shapes import ShapeEnv

        channels = call.run(anynet_ext, call.make()).shape[1]
        env = ShapeEnv()
        n, h, w = (env.create_unbacked_symint() for _ in range(3))
        with FakeTensorMode(shape_env=env):
            tensors = [
                None if t is None else torch.empty(n, *t.shape[1:-2], h, w, dtype=torch.float16) for t in call.make()
            ]
            arguments = backward_arguments(call, tensors)
            out = arguments[0]
            assert [str(s) for s in out.shape] == [str(s) for s in (n, channels, h, w)]
            assert out.dtype == torch.float16
            grads = getattr(torch.ops.anynet, f"{call.op}_backward")(*arguments)
            grads = [grads] if isinstance(grads, Tensor) else grads
            for grad, t in zip(grads, present(tensors), strict=False):
                assert [str(s) for s in grad.shape] == [str(s) for s in t.shape]

    def test_vmap(self, call):
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

    def test_vmap_backward(self, call):
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

    def test_inference_mode(self, call):
        tensors = call.make()
        with torch.inference_mode():
            out = call.run(anynet_ext, [None if t is None else t.clone() for t in tensors])
        assert out.is_inference()
        torch.testing.assert_close(out, call.run(anynet_ext, tensors), rtol=0, atol=0)

    @pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16], ids=str)
    def test_autocast(self, call, dtype):
        """Under autocast the operators compute in float32, also mixtures with half types."""
        tensors = [None if t is None else t.to(dtype if i == 0 else torch.float32) for i, t in enumerate(call.make())]
        leaves(tensors)
        with torch.autocast("cpu", dtype):
            out = call.run(anynet_ext, tensors)
        assert out.dtype == torch.float32
        torch.testing.assert_close(out, call.run(anynet_ext, [None if t is None else t.float() for t in tensors]))
        grads = torch.autograd.grad(out.sum(), present(tensors))
        assert [g.dtype for g in grads] == [t.dtype for t in present(tensors)]

    def test_only_wanted_gradients(self, call):
        for i, t in enumerate(present(call.make())):
            tensors = call.make()
            leaf = tensors[i] = t.requires_grad_()
            (grad,) = torch.autograd.grad(call.run(anynet_ext, tensors).sum(), leaf)
            assert grad.shape == leaf.shape

    def test_function_errors(self, function_error):
        args, error, message = function_error
        with pytest.raises(error) as caught:
            getattr(anynet_ext, self.op)(*args)
        assert str(caught.value) == message

    def test_operator_errors(self, ops, operator_error):
        name, args, message = operator_error
        args = [a.to(ops.device) if isinstance(a, Tensor) else a for a in args]
        with pytest.raises(RuntimeError) as caught:
            getattr(getattr(torch.ops, ops.namespace), name)(*args)
        assert str(caught.value).splitlines()[0] == message

    def test_meta_tensors_are_checked_too(self, function_error):
        """By the operator itself, where nothing else would."""
        args, error, message = function_error
        tensors = [a for a in args if isinstance(a, Tensor)]
        if len({t.device for t in tensors}) > 1 or "to be" in message:
            pytest.skip("no call that reaches it")
        with pytest.raises(error) as caught:
            getattr(torch.ops.anynet, self.op)(*[a.to("meta") if isinstance(a, Tensor) else a for a in args])
        assert str(caught.value) == message

    def test_devices(self, call):
        """A CPU operator does not silently take a tensor without data."""
        tensors = call.make()
        if len(present(tensors)) == 1:
            pytest.skip("takes one tensor")
        for i, t in enumerate(tensors):
            if t is None:
                continue
            mixed = [*tensors[:i], t.to("meta"), *tensors[i + 1 :]]
            with pytest.raises(RuntimeError, match=f"{self.op}: expected all tensors on one device, got cpu and meta"):
                getattr(torch.ops.anynet, self.op)(*mixed, *call.numbers)
