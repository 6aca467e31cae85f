"""What every compiled operator registers with PyTorch: shapes, derivatives, autocast, vmap."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual
from torch.overrides import handle_torch_function, has_torch_function

P = ParamSpec("P")
R = TypeVar("R")


# `has_torch_function` is also true within a mode, but modes see the operator itself.
_USUAL = (None, Tensor.__torch_function__, torch.nn.Parameter.__torch_function__)


def overridable(function: Callable[P, R]) -> Callable[P, R]:
    """Gives arguments with a `__torch_function__` of their own the call, as PyTorch's functions do.

    So `torch.fx.symbolic_trace` sees one call in the place of checks of tensors that it does not have.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        values = (*args, *kwargs.values())
        for group in (values, *(value for value in values if isinstance(value, (list, tuple)))):
            if has_torch_function(group) and any(
                getattr(type(value), "__torch_function__", None) not in _USUAL for value in group
            ):
                result: R = handle_torch_function(call, group, *args, **kwargs)
                return result
        return function(*args, **kwargs)

    return call


def _vmap_rule(name: str, shared: tuple[str, ...]) -> Callable[..., Any]:
    """A tensor's first dimension is the batch, so the mapped one is folded into it; `shared` tensors have no batch."""
    op: Any = getattr(torch.ops.anynet, name.split("::")[1])
    arguments = [argument.name for argument in op.default._schema.arguments]

    def rule(info: Any, in_dims: tuple[int | None, ...], *args: Any) -> tuple[Any, Any]:
        size, batch = info.batch_size, 0

        def folded(argument: str, value: Any, dim: int | None) -> Any:
            nonlocal batch
            if not isinstance(value, Tensor):
                return value
            if argument in shared:
                if dim is not None:
                    raise RuntimeError(f"{name}: vmap over {argument} is not supported, only over tensors with a batch")
                return value
            batched = value.expand(size, *value.shape) if dim is None else value.movedim(dim, 0)
            batch = batched.shape[1]
            return batched.flatten(0, 1)

        def unfolded(value: Tensor) -> Tensor:
            return value.reshape(size, len(value) // size if size else batch, *value.shape[1:])

        out = op(*[folded(*each) for each in zip(arguments, args, in_dims, strict=False)])  # the rest: defaults
        if isinstance(out, Tensor):
            return unfolded(out), 0
        return tuple(unfolded(t) for t in out), tuple(0 for _ in out)

    return rule


def _tensors(values: Iterable[Any]) -> Iterator[Tensor]:
    for value in values:
        yield from (
            each for each in (value if isinstance(value, (list, tuple)) else [value]) if isinstance(each, Tensor)
        )


class _Derivatives(torch.library.Library):
    """What `register_derivative` registers with: PyTorch would lose forward-mode derivatives without a word."""

    def impl(self, op_name: str, fn: Callable[..., Any], dispatch_key: str = "", **options: Any) -> None:
        @wraps(fn)
        def checked(keyset: Any, *args: Any, **kwargs: Any) -> Any:
            tensors = _tensors([*args, *kwargs.values()])
            if any(unpack_dual(tensor).tangent is not None for tensor in tensors):  # type: ignore[no-untyped-call]
                raise NotImplementedError(f"anynet::{op_name}: forward-mode derivatives are not supported")
            return fn(keyset, *args, **kwargs)

        super().impl(op_name, checked, dispatch_key, **options)  # type: ignore[no-untyped-call]


_derivatives = _Derivatives("anynet", "FRAGMENT")  # type: ignore[no-untyped-call]


def register_derivative(name: str, backward: Callable[..., Any], **options: Any) -> None:
    """As `torch.library.register_autograd`."""
    torch.library.register_autograd(name, backward, lib=_derivatives, **options)


def no_second_derivative(name: str) -> Callable[..., None]:
    def backward(ctx: Any, *grads: Tensor | None) -> None:
        raise RuntimeError(f"{name} has no derivative: second derivatives of this operator are not supported")

    return backward


def register_fake(name: str, fake: Callable[..., Any]) -> None:
    """Registers results without data. PyTorch asks for these too if only some tensors are on the meta device: no."""

    def checked(*args: Any, **kwargs: Any) -> Any:
        devices = sorted({str(tensor.device) for tensor in _tensors([*args, *kwargs.values()])})
        if len(devices) > 1:
            raise RuntimeError(f"{name}: expected all tensors on one device, got {' and '.join(devices)}")
        return fake(*args, **kwargs)

    torch.library.register_fake(name, checked)


def register_inference(name: str, fake: Callable[..., Any]) -> None:
    """Gives the compiled operator `anynet::<name>`, which has no derivative, what PyTorch asks of it.

    Args:
        fake: results of the right shape, dtype and layout, without data.
    """
    op = f"anynet::{name}"

    def no_gradient(ctx: Any, *grads: Tensor | None) -> None:
        raise RuntimeError(f"{op} has no gradients: it is for inference")

    register_fake(op, fake)
    register_derivative(op, no_gradient)


def register_out(name: str, fake: Callable[..., Any]) -> None:
    """Gives `anynet::<name>.out`, which writes to its argument `out` and has no derivative, what PyTorch asks of it."""
    op = f"{name}.out"
    overload = getattr(torch.ops.anynet, name).out

    def without_gradient(keyset: Any, *args: Any, out: Tensor) -> Any:
        if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in _tensors([out, *args])):
            raise RuntimeError(f"{name}: expected out and maps that do not require gradients: it is for inference")
        with torch._C._AutoDispatchBelowAutograd():
            return overload.redispatch(keyset & torch._C._after_autograd_keyset, *args, out=out)

    def with_a_new_version(keyset: Any, *args: Any, out: Tensor) -> Any:
        """So that backward notices if it needed the old values."""
        with torch._C._AutoDispatchBelowADInplaceOrView():
            result = overload.redispatch(keyset & torch._C._after_ADInplaceOrView_keyset, *args, out=out)
        if not out.is_inference():
            torch.autograd.graph.increment_version(out)
        return result

    register_fake(f"anynet::{op}", fake)
    _derivatives.impl(op, without_gradient, "Autograd", with_keyset=True)
    _derivatives.impl(op, with_a_new_version, "ADInplaceOrView", with_keyset=True)


def register(
    name: str,
    *,
    fake: Callable[..., Any],
    fake_backward: Callable[..., Any] | Mapping[str, Callable[..., Any]],
    setup_context: Callable[..., None],
    backward: Callable[..., Any],
    shared: tuple[str, ...] = (),
) -> None:
    """Gives the compiled operators `anynet::<name>` and `anynet::<name>_backward` all that PyTorch asks of them.

    Args:
        fake, fake_backward: results of the right shape, dtype and layout, without data. If the derivative is several
            operators, `anynet::<name>_<key>` by key.
        setup_context, backward: as in `torch.library.register_autograd`.
        shared: names of the tensors that have no batch dimension, over which vmap cannot map.
    """
    forward_name = f"anynet::{name}"
    backwards = fake_backward if isinstance(fake_backward, Mapping) else {"backward": fake_backward}
    register_fake(forward_name, fake)
    register_derivative(forward_name, backward, setup_context=setup_context)
    torch.library.register_vmap(forward_name, _vmap_rule(forward_name, shared))
    for key, fake_of_key in backwards.items():
        backward_name = f"{forward_name}_{key}"
        register_fake(backward_name, fake_of_key)
        register_derivative(backward_name, no_second_derivative(backward_name))
        if not shared:  # else a result is a sum over the batch
            torch.library.register_vmap(backward_name, _vmap_rule(backward_name, shared))
    for device in ("cpu", "cuda"):
        torch.library.register_autocast(forward_name, device, torch.float32)
