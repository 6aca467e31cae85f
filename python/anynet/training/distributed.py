"""Data-parallel training under `torchrun`: process group, and batch norm over the batches of all processes."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn

from anynet.device import missing_for_cuda
from anynet.errors import AnyNetError, one_line
from anynet.model.layers import track


@dataclass(frozen=True)
class Processes:
    """This process among all of the run."""

    rank: int
    world_size: int
    device: torch.device
    patient: Any = None  # a group that waits for as long as it takes

    @property
    def is_main(self) -> bool:
        return self.rank == 0

    def barrier(self) -> None:
        """Until every process is here, however long that takes: one of them may be validating."""
        if self.world_size > 1:
            dist.barrier(self.patient)

    def all_reduce_sum(self, value: Tensor) -> Tensor:
        """Sum of `value` over the processes."""
        if self.world_size > 1:
            dist.all_reduce(value)
        return value


def _number(name: str, default: int | None = None) -> int:
    text = os.environ.get(name, None if default is None else str(default))
    if text is None or not re.fullmatch("[0-9]{1,6}", text):
        raise AnyNetError(f"expected {name} in the environment to be a number, as torchrun sets it, got {text!r}")
    return int(text)


@contextmanager
def process_group(device: str | None) -> Iterator[Processes]:
    """Joins the process group that torchrun describes in the environment; one process where there is none.

    Raises:
        AnyNetError: if there is no such device here, or the environment describes no process.
    """
    kind = device or ("cuda" if torch.cuda.is_available() else "cpu")
    if kind not in ("cpu", "cuda"):
        raise AnyNetError(f"device: expected cpu or cuda, got {kind!r}")
    if kind == "cuda" and not torch.cuda.is_available():
        raise AnyNetError(f"device 'cuda': {missing_for_cuda()}")
    world_size = _number("WORLD_SIZE", 1)
    if world_size == 1:
        yield Processes(0, 1, torch.device(kind))
        return
    rank = _number("RANK")
    if kind == "cuda":
        local = _number("LOCAL_RANK")
        torch.cuda.set_device(local)
        kind = f"cuda:{local}"
    try:
        dist.init_process_group("nccl" if kind.startswith("cuda") else "gloo", rank=rank, world_size=world_size)
        patient = dist.new_group(backend="gloo", timeout=timedelta(days=7))
    except (RuntimeError, ValueError) as error:
        raise AnyNetError(f"cannot join the run's other processes: {one_line(error)}") from error
    try:
        yield Processes(dist.get_rank(), world_size, torch.device(kind), patient)
    finally:
        dist.destroy_process_group()


class _AllReduceSum(torch.autograd.Function):
    """Sum over the processes. Every process's loss depends on it, so its gradient is the sum of theirs."""

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        total = value.clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        total = gradient.clone()
        dist.all_reduce(total)
        return total


def _all_reduce_sum(value: Tensor) -> Tensor:
    total: Tensor = _AllReduceSum.apply(value)  # type: ignore[no-untyped-call, unused-ignore]
    return total


class _SyncBatchNorm(nn.modules.batchnorm._BatchNorm):
    """Batch norm with the statistics of all processes, on any device (PyTorch's own works on CUDA only)."""

    def _check_input_dim(self, input: Tensor) -> None:
        pass

    def forward(self, input: Tensor) -> Tensor:
        if not self.training:
            return super().forward(input)
        axes = [0, *range(2, input.dim())]
        shape = [1, -1] + [1] * (input.dim() - 2)
        here = input.new_tensor(input.numel() // input.shape[1])
        sums = _all_reduce_sum(torch.cat([input.sum(axes), here[None]]))
        count = sums[-1].detach()
        mean = sums[:-1] / count
        centered = input - mean.view(shape)
        # Two passes: the difference of large sums would lose the variance in float32.
        variance = _all_reduce_sum(centered.square().sum(axes)) / count
        track(self, mean, variance, count)
        scale = self.weight * torch.rsqrt(variance + self.eps)
        return torch.addcmul(self.bias.view(shape), centered, scale.view(shape))


def synchronize_batch_norm(model: nn.Module, device: torch.device) -> None:
    """Makes every batch norm inside the model take its statistics over the batches of all processes."""
    if device.type == "cuda":
        nn.SyncBatchNorm.convert_sync_batchnorm(model)  # type: ignore[no-untyped-call]
        return
    for parent in list(model.modules()):
        for name, child in parent.named_children():
            if isinstance(child, nn.modules.batchnorm._BatchNorm):
                norm = _SyncBatchNorm(child.num_features, child.eps, child.momentum)
                norm.load_state_dict(child.state_dict())
                setattr(parent, name, norm)
