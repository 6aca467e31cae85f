"""What every operator of the deployed network must do: one table of calls and one of wrong calls drive all of it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

import pytest
import torch
from operator_cases import ISAS, from_array, to_array
from torch import Tensor

import anynet_ext
from anynet_ext import _kernels, reference

Call = Callable[[], tuple[tuple[Any, ...], dict[str, Any]]]


def random(*shape: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(sum(shape)))


def image(height: int, width: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(height * width + seed)
    return torch.randint(0, 256, (height, width, 3), dtype=torch.uint8, generator=generator)


def call(*args: Any, **options: Any) -> tuple[tuple[Any, ...], dict[str, Any]]:
    return args, options


def strided(t: Tensor) -> Tensor:
    """The same values, two elements apart."""
    return torch.stack([t, t], -1)[..., 0]


@cache  # for the operator and each of its instruction sets
def expected(op: str, case: Call) -> Tensor:
    """The reference's result."""
    args, options = case()
    return getattr(reference, op)(*args, **options)


class InferenceOperator:
    """Base class of a test class; its lists are the values of its tests' parameters (see conftest.py).

    Attributes:
        op: the operator's name.
        cases: calls of `anynet_ext.<op>`, by name; the first two are small.
        errors: wrong calls, and what the message must match.
        any_layout: tensors that need not be contiguous.
        tolerance: of the comparison with the reference.
    """

    op: ClassVar[str]
    cases: ClassVar[dict[str, Call]]
    errors: ClassVar[list[tuple[Call, str]]]
    any_layout: ClassVar[tuple[str, ...]] = ()
    tolerance: ClassVar[dict[str, float]] = {"rtol": 1e-4, "atol": 1e-5}
    small_cases: ClassVar[dict[str, Call]]

    def __init_subclass__(cls) -> None:
        cls.small_cases = dict(list(cls.cases.items())[:2])

    def run(self, module: Any, case: Call) -> Tensor:
        args, options = case()
        return getattr(module, self.op)(*args, **options)

    @property
    def packet(self) -> Any:
        return getattr(torch.ops.anynet, self.op).default

    def run_on(self, ops: Any, arguments: list[Any]) -> Tensor:
        """The operator of an implementation under test, its tensors on its device."""
        moved = torch.utils._pytree.tree_map_only(Tensor, lambda t: t.to(ops.device), arguments)
        return getattr(getattr(torch.ops, ops.namespace), self.op).default(*moved)

    def arguments(self, case: Call) -> list[Any]:
        """Those of a call in the order of the schema."""
        args, options = case()
        bound = inspect.signature(getattr(anynet_ext, self.op)).bind(*args, **options)
        bound.apply_defaults()
        return [bound.arguments[argument.name] for argument in self.packet._schema.arguments]

    def test_equals_reference(self, case: Call) -> None:
        """Also bit for bit whatever the number of threads."""
        before, results = torch.get_num_threads(), []
        try:
            for threads in (1, 2, 5):
                torch.set_num_threads(threads)
                results.append(self.run(anynet_ext, case))
        finally:
            torch.set_num_threads(before)
        torch.testing.assert_close(results[0], expected(self.op, case), **self.tolerance)
        assert results[0].is_contiguous()
        assert all(torch.equal(results[0], other) for other in results[1:])

    def test_cuda_equals_reference(self, cuda: Any, case: Call) -> None:
        """And repeats bit for bit."""
        out, again = (self.run_on(cuda, self.arguments(case)) for _ in range(2))
        torch.testing.assert_close(out.cpu(), expected(self.op, case), **self.tolerance)
        assert out.is_contiguous()
        assert torch.equal(out, again)

    def test_cuda_refuses_what_the_cpu_does(self, cuda: Any) -> None:
        for wrong_call, message in self.errors:
            with pytest.raises(RuntimeError, match=message):
                self.run_on(cuda, self.arguments(wrong_call))
        for case in self.small_cases.values():
            for arguments in self.changed(case, lambda t: t.to(torch.int32)).values():
                with pytest.raises(RuntimeError, match=f"{self.op}: expected"):
                    self.run_on(cuda, arguments)

    @pytest.mark.parametrize("isa", ISAS, ids=lambda isa: isa.name)
    def test_every_instruction_set_equals_reference(self, case: Call, isa: Any) -> None:
        def array(value: Any) -> Any:
            if isinstance(value, list):
                return [array(each) for each in value]
            return to_array(value) if isinstance(value, Tensor) else value

        if expected(self.op, case).numel() == 0:
            pytest.skip("the kernels are not called for empty results")
        out = getattr(_kernels, self.op)(isa, *map(array, self.arguments(case)), 2)
        torch.testing.assert_close(from_array(out), expected(self.op, case), **self.tolerance)

    def changed(self, case: Call, change: Callable[[Tensor], Tensor]) -> dict[str, list[Any]]:
        """By each tensor's name, the arguments of a call with this tensor changed."""
        arguments = self.arguments(case)
        result = {}
        for i, (argument, value) in enumerate(zip(self.packet._schema.arguments, arguments, strict=True)):
            if isinstance(value, Tensor):
                result[argument.name] = [*arguments[:i], change(value), *arguments[i + 1 :]]
            elif isinstance(value, list) and isinstance(value[-1], Tensor):
                result[argument.name] = [*arguments[:i], [*value[:-1], change(value[-1])], *arguments[i + 1 :]]
        assert result
        return result

    def test_layouts(self, small_case: Call) -> None:
        expected = self.packet(*self.arguments(small_case))
        for name, arguments in self.changed(small_case, strided).items():
            if not any(
                isinstance(t, Tensor) and not t.is_contiguous() for t in torch.utils._pytree.tree_leaves(arguments)
            ):
                continue  # a tensor of one element is contiguous however it is made
            if name in self.any_layout:
                assert torch.equal(self.packet(*arguments), expected)
            else:
                with pytest.raises(RuntimeError, match=f"{self.op}: expected .* contiguous"):
                    self.packet(*arguments)

    @pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.bfloat16, torch.int32], ids=str)
    def test_dtypes(self, small_case: Call, dtype: torch.dtype) -> None:
        for arguments in self.changed(small_case, lambda t: t.to(dtype)).values():
            with pytest.raises(RuntimeError, match=f"{self.op}: expected"):
                self.packet(*arguments)

    def test_devices(self, small_case: Call) -> None:
        if len(self.changed(small_case, Tensor.clone)) == 1 and not isinstance(self.arguments(small_case)[0], list):
            pytest.skip("takes one tensor")
        for arguments in self.changed(small_case, lambda t: t.to("meta")).values():
            with pytest.raises(RuntimeError, match=f"{self.op}: expected all tensors on one device, got cpu and meta"):
                self.packet(*arguments)

    def test_opcheck(self, small_case: Call) -> None:
        torch.library.opcheck(self.packet, tuple(self.arguments(small_case)))

    def test_gradients_are_refused(self, small_case: Call) -> None:
        for arguments in self.changed(small_case, lambda t: t.clone().requires_grad_(t.is_floating_point())).values():
            out = self.packet(*arguments)
            if out.requires_grad:
                with pytest.raises(RuntimeError, match=f"anynet::{self.op} has no gradients"):
                    out.sum().backward()

    def test_forward_mode_is_refused(self, small_case: Call) -> None:
        def dual(t: Tensor) -> Tensor:
            return torch.autograd.forward_ad.make_dual(t, torch.ones_like(t)) if t.is_floating_point() else t

        with torch.autograd.forward_ad.dual_level():
            for arguments in self.changed(small_case, dual).values():
                tensors = [t for t in torch.utils._pytree.tree_leaves(arguments) if isinstance(t, Tensor)]
                if any(torch.autograd.forward_ad.unpack_dual(t).tangent is not None for t in tensors):
                    with pytest.raises(NotImplementedError, match=f"anynet::{self.op}: forward-mode derivatives"):
                        self.packet(*arguments)

    def test_errors(self, error: tuple[Call, str]) -> None:
        wrong_call, message = error
        with pytest.raises(RuntimeError, match=message):
            self.run(anynet_ext, wrong_call)
