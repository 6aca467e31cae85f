"""What every compiled operator registers with PyTorch: shapes, derivatives, autocast, vmap."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor


def _vmap_rule(name: str) -> Callable[..., Any]:
    """Every tensor's first dimension is the batch, so the mapped dimension is folded into it."""
    op: Callable[..., Any] = getattr(torch.ops.anynet, name.split("::")[1])

    def fold(value: Any, dim: int | None, size: int) -> Any:
        if not isinstance(value, Tensor):
            return value
        batched = value.expand(size, *value.shape) if dim is None else value.movedim(dim, 0)
        return batched.flatten(0, 1)

    def unfold(value: Tensor, size: int) -> Tensor:
        return value.reshape(size, value.shape[0] // size, *value.shape[1:])

    def rule(info: Any, in_dims: tuple[int | None, ...], *args: Any) -> tuple[Any, Any]:
        size = info.batch_size
        out = op(*[fold(value, dim, size) for value, dim in zip(args, in_dims, strict=True)])
        if isinstance(out, Tensor):
            return unfold(out, size), 0
        return tuple(unfold(t, size) for t in out), tuple(0 for _ in out)

    return rule


def _no_second_derivative(name: str) -> Callable[..., None]:
    def backward(ctx: Any, *grads: Tensor | None) -> None:
        raise RuntimeError(f"{name} has no derivative: second derivatives of this operator are not supported")

    return backward


def register(
    name: str,
    *,
    fake: Callable[..., Any],
    fake_backward: Callable[..., Any],
    setup_context: Callable[..., None],
    backward: Callable[..., Any],
) -> None:
    """Gives the compiled operators `anynet::<name>` and `anynet::<name>_backward` all that PyTorch asks of them.

    Args:
        fake, fake_backward: results of the right shape, dtype and layout, without data.
        setup_context, backward: as in `torch.library.register_autograd`.
    """
    forward_name, backward_name = f"anynet::{name}", f"anynet::{name}_backward"
    torch.library.register_fake(forward_name, fake)
    torch.library.register_fake(backward_name, fake_backward)
    torch.library.register_autograd(forward_name, backward, setup_context=setup_context)
    torch.library.register_autograd(backward_name, _no_second_derivative(backward_name))
    for each in (forward_name, backward_name):
        torch.library.register_vmap(each, _vmap_rule(each))
    for device in ("cpu", "cuda"):
        torch.library.register_autocast(forward_name, device, torch.float32)
