"""Scratch memory that cannot be had is an exception, also when a thread of several asks for it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import anynet_ext

OUT_OF_MEMORY = MemoryError if torch.torch_version.TorchVersion(torch.__version__) < (2, 15) else RuntimeError


def channels(rows: int) -> Tensor:
    """More channels than any memory holds, all of them one."""
    return torch.zeros(1).expand(1, 2**44, rows, 1)


CALLS: dict[str, Callable[[], object]] = {
    "forward": lambda: anynet_ext.cost_volume(channels(1), channels(1)),
    "forward, threads": lambda: anynet_ext.cost_volume(channels(8), channels(8)),
    "forward around a map, threads": lambda: anynet_ext.cost_volume(channels(8), channels(8), torch.zeros(1, 1, 8, 1)),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS.keys())
def test_an_exception(call: Callable[[], object], threads: Callable[[int], None]) -> None:
    threads(2)
    with pytest.raises(OUT_OF_MEMORY, match="expected enough memory for the operator's scratch, got none"):
        call()


def test_sizes_that_no_arithmetic_holds() -> None:
    with pytest.raises(RuntimeError, match="at most 2\\^48 elements"):
        anynet_ext.soft_argmin(torch.zeros(1).expand(1, 2**50, 1, 1))
    with pytest.raises(RuntimeError, match=r"at most 2\^30 along each side, got 1099511627776 x 1"):
        anynet_ext.resize(torch.zeros(0, 1, 1, 1), (2**40, 1))
    with pytest.raises(RuntimeError, match="less than 2\\^30 columns"):
        torch.ops.anynet.warp(*[torch.zeros(1).expand(1, 1, 1, 2**31)] * 2)


def test_results_and_copies_that_no_memory_holds() -> None:
    row = torch.zeros(1, 1, 1, 2**16)
    with pytest.raises(RuntimeError, match=r"memory for a result of shape \[1, 536870913, 1, 65536\], got none"):
        anynet_ext.cost_volume(row, row, None, 0, 2**29)
    large = torch.zeros(1).expand(1, 64, 2**20, 2**20)
    with pytest.raises(
        RuntimeError, match=r"memory for a contiguous copy of shape \[1, 64, 1048576, 1048576\], got none"
    ):
        anynet_ext.conv3x3(large, torch.ones(1, 64, 3, 3))


def test_an_empty_result_needs_no_memory() -> None:
    assert anynet_ext.resize(torch.zeros(0, 1, 1, 1), (2**30, 1)).shape == (0, 1, 2**30, 1)
