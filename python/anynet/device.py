"""The devices that networks compute on."""

from __future__ import annotations

import re

import torch
from torch import Tensor

from anynet.errors import AnyNetError, one_line
from anynet_ext import build_info

PRECISIONS = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
BFLOAT16 = 8, 0  # the first compute capability whose tensor cores know it


def find_device(name: str) -> torch.device:
    """The device of that name.

    Args:
        name: "cpu"; "cuda", the current GPU; "cuda:1", that one; "auto", the first GPU if there is one, else the CPU.

    Raises:
        AnyNetError: if it is none of these, or not there.
    """
    if not isinstance(name, str) or not re.fullmatch(r"cpu|auto|cuda(:\d+)?", name):
        raise AnyNetError(f"expected device 'cpu', 'cuda', 'cuda:N' or 'auto', got {name!r}")
    missing = "" if name == "cpu" else missing_for_cuda()
    if name == "cpu" or (name == "auto" and missing):
        return torch.device("cpu")
    if missing:
        raise AnyNetError(f"device {name!r}: {missing}")
    count = torch.cuda.device_count()
    try:
        index = 0 if name == "auto" else int(name[5:]) if ":" in name else torch.cuda.current_device()
    except RuntimeError as error:  # in a forked process
        raise AnyNetError(f"device {name!r}: {one_line(error)}") from error
    if index >= count:
        raise AnyNetError(f"device {name!r}: expected one of the {count} GPUs here, cuda:0 to cuda:{count - 1}")
    return torch.device("cuda", index)


def find_precision(name: str, device: torch.device) -> torch.dtype:
    """The type of that name, "float32", "bfloat16" or "float16", for convolutions on that device.

    Raises:
        AnyNetError: if it is none of these, or the device does not compute in it.
    """
    if not isinstance(name, str) or name not in PRECISIONS:
        raise AnyNetError(f"expected precision 'float32', 'bfloat16' or 'float16', got {name!r}")
    if name != "float32" and device.type == "cpu":
        raise AnyNetError(f"precision {name!r} is for a GPU: expected 'float32' on the CPU")
    if name == "bfloat16" and torch.cuda.get_device_capability(device) < BFLOAT16:
        capability = ".".join(map(str, torch.cuda.get_device_capability(device)))
        raise AnyNetError(f"precision 'bfloat16': expected compute capability 8.0 or newer, got {capability}")
    return PRECISIONS[name]


def missing_for_cuda() -> str:
    """What CUDA lacks here, and what to do about it; empty if nothing."""
    if torch.version.cuda is None:
        return f"PyTorch {torch.__version__} is a build without CUDA: install one with CUDA (pytorch.org)"
    operators = build_info()["cuda_operators"]
    if operators != "yes":
        return f"AnyNet's CUDA operators are {operators}: install it where nvcc is, with ANYNET_CUDA=ON"
    if not torch.cuda.is_available():
        return "PyTorch sees no GPU: look at nvidia-smi and CUDA_VISIBLE_DEVICES"
    return ""


class DeviceClock:
    """Tells the time that a GPU takes, by events on its current stream."""

    def __init__(self, device: torch.device) -> None:
        self._device = device

    def mark(self) -> torch.cuda.Event:
        event = torch.cuda.Event(enable_timing=True)  # type: ignore[no-untyped-call]
        event.record(torch.cuda.current_stream(self._device))
        return event

    def seconds(self, begin: torch.cuda.Event, end: torch.cuda.Event) -> float:
        """Between two marks; waits for the second."""
        end.synchronize()
        return float(begin.elapsed_time(end)) / 1e3


class HostCopy:
    """A tensor's values on their way to the host, which does not wait for the device before it reads them."""

    def __init__(self, tensor: Tensor) -> None:
        self._copy = tensor.to("cpu", non_blocking=True)  # of a GPU's tensor, in pinned memory
        self._there: torch.cuda.Event | None = None
        if tensor.is_cuda:
            self._there = torch.cuda.Event()  # type: ignore[no-untyped-call]
            self._there.record(torch.cuda.current_stream(tensor.device))

    def tolist(self) -> list[float]:
        """As `Tensor.tolist`."""
        if self._there is not None:
            self._there.synchronize()
        values: list[float] = self._copy.tolist()
        return values
